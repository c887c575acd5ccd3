"""Another trainer's Gaussians as a keyframe: turned to the rig's world, compensated, and put on a lattice.

Chosen: nothing is trained. The lattice is the coarsest, halving its steps from the settings', that costs no more than
.1 dB on the training views: Gaussians that were not trained to a lattice bear less rounding than ours. The orientation
of a file's world is not in its format: of those that programs write, the one that matches the pictures is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.scene.lattice import Lattice, default_lattice, dequantise, quantise, robust_extent
from decogs.codec.scene.state import Attributes
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.geometry.similarity import NO_CHANGE, Similarity, transformed_splats
from decogs.formats.geometry.up_direction import AXES, turn_between, up_of
from decogs.formats.splats import Splats, logit, sh_degree_of, sigmoid, take_splats
from decogs.rig.pictures.ingest import Ingest, RigFrame

from ..backends import TrainingKernel
from ..backends.psnr import mean_psnr
from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..settings.encode import EncodeSettings
from .harmonics import trim_sh_degree

MAX_ROUNDING_LOSS_DB = 0.1
"""dB of the first frame's training views that rounding may cost."""
_MAX_HALVINGS = 5
_HALF_A_TURN = Similarity(np.diag([1.0, -1.0, -1.0]))
_FILTER_VARIANCE = 0.3
"""Variance of the low-pass filter, square pixels (Kerbl 2023)."""
_MAX_OPACITY = 0.99
_CHUNK_ROWS = 1 << 16
_LARGEST_INTEGER = float(1 << 30)


@dataclass(frozen=True)
class ImportedSplats:
    """The keyframe, and what the user should know of it, a line each."""

    source: KeyframeSource
    warnings: tuple[str, ...]


def import_splats(
    kernel: TrainingKernel, ingest: Ingest, frame: RigFrame, settings: EncodeSettings, source: SplatSource
) -> ImportedSplats:
    """The keyframe that a file of Gaussians gives for the rig's ``frame``; sets the ingest's near planes.

    Raises UsageError where its Gaussians have no extent.
    """
    warnings = [*source.file.left_out]
    extent, centre = robust_extent(source.file.splats.means)
    if not extent > 0:
        raise UsageError(f"`keyframe` {source.path}: all its Gaussians are in one place; export it again")
    fits = _fits(
        source.file.splats, default_lattice(extent, centre=centre, scale=settings.lattice_scale / 2**_MAX_HALVINGS)
    )
    warnings += _left_out(int((~fits).sum()), "lie too far out for 32 bits")
    splats, turned = _turned(kernel, ingest, frame, source, take_splats(source.file.splats, fits))
    if turned:
        warnings.append("its world is turned against the rig's, and was turned back as its pictures show")
    if not source.file.compensated:
        splats = with_compensation(splats, [scale_camera(view.pinhole, 1 / ingest.scale) for view in ingest.views])
        warnings.append(
            "it does not say that it was trained with antialiasing (Mip-Splatting), which our renderer has, so "
            "opacities and sizes were raised to make up for it; train with antialiasing where you can"
        )
    points, lattice, scale, lost = _on_lattice(kernel, ingest, frame, settings, splats)
    if lost > MAX_ROUNDING_LOSS_DB:
        warnings.append(f"the lattice costs {lost:.2f} dB of frame {frame.index}; raise `quality`")
    state, _ = keyframe_state(points)
    header = StreamHeader(
        cameras=ingest.cameras,
        lattice=lattice,
        sh_degree=sh_degree_of(points.coefficients),
        first_frame=frame.index,
        held_out=tuple(view.camera.name for view in ingest.held_out_views),
        settings={"keyframe": source.document, "lattice_scale": scale},
    )
    try:
        header.to_bytes()
    except StreamError:
        raise UsageError(
            f"`keyframe` {source.path}: a stream cannot hold a scene of {extent:.3g} units; scale it to metres"
        ) from None
    texts = tuple(f"`keyframe` {source.path}: {text}" for text in warnings)
    return ImportedSplats(KeyframeSource(source.path, header, state), texts)


def with_compensation(splats: Splats, cameras: Sequence[Camera]) -> Splats:
    """Gaussians trained without compensation, changed so that the compensated renderer shows nearly what theirs did.

    The opacity of each is divided by what it loses in the pictures of the ``cameras`` that see it, in their geometric
    mean, up to .99. What is lacking then is made up for by size: opacity times area stays that of the filtered
    Gaussian. Source: Mip-Splatting, equation 9, with the filter of Kerbl 2023.
    Measured on `workbench`, trained without compensation: 30.67 dB in its own renderer, 24.32 as it is in ours, 27.98
    with opacities alone, 29.91 with both.
    """
    factors = np.concatenate(
        [
            _compensation(take_splats(splats, np.arange(first, min(first + _CHUNK_ROWS, len(splats)))), cameras)
            for first in range(0, len(splats), _CHUNK_ROWS)
        ]
    )
    opacities = sigmoid(splats.opacity_logits.astype(np.float64))
    wanted = opacities / factors
    # One that is already nearer to 1 stays there.
    raised = np.clip(np.maximum(opacities, np.minimum(wanted, _MAX_OPACITY)), 1e-12, 1 - 1e-12)
    logits = np.where(raised > opacities, logit(raised), splats.opacity_logits)
    growth = 0.5 * np.log(np.maximum(wanted / np.maximum(opacities, _MAX_OPACITY), 1))
    return replace(
        splats,
        opacity_logits=np.asarray(logits, np.float32),
        log_scales=(splats.log_scales + growth[:, None]).astype(np.float32),
    )


def _compensation(splats: Splats, cameras: Sequence[Camera]) -> NDArray[np.float64]:
    """sqrt(det / det of the filtered) in the cameras' pictures: geometric mean, 1 for what none sees."""
    logs, seen = np.zeros(len(splats)), np.zeros(len(splats))
    axes = (
        rotation_matrices(splats.quaternions.astype(np.float64))
        * np.exp(np.clip(splats.log_scales.astype(np.float64), -40, 40))[:, None, :]
    )
    for camera in cameras:
        pose = camera.world_to_camera
        position = splats.means.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        with np.errstate(all="ignore"):
            z = position[:, 2]
            x, y = position[:, 0] / z, position[:, 1] / z
            u, v = x * camera.fx + camera.cx, y * camera.fy + camera.cy
            visible = (z > camera.near) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
            turned = pose[:3, :3] @ axes
            across = (turned[:, 0] - x[:, None] * turned[:, 2]) * (camera.fx / z)[:, None]
            down = (turned[:, 1] - y[:, None] * turned[:, 2]) * (camera.fy / z)[:, None]
            a, c = (across**2).sum(axis=1), (down**2).sum(axis=1)
            det = (np.cross(across, down) ** 2).sum(axis=1)
            log = 0.5 * np.log(np.maximum(det, 1e-30) / (det + _FILTER_VARIANCE * (a + c) + _FILTER_VARIANCE**2))
        visible &= np.isfinite(log)
        logs[visible] += log[visible]
        seen += visible
    return np.asarray(np.exp(logs / np.maximum(seen, 1)))


def _turned(
    kernel: TrainingKernel, ingest: Ingest, frame: RigFrame, source: SplatSource, splats: Splats
) -> tuple[Splats, bool]:
    """The Gaussians in the rig's world, and whether they had to be turned otherwise than their format has it."""
    exported = Similarity(turn_between(up_of(ingest.rig.cameras), AXES[source.file.up]).T)
    # As the world of the rig itself, for .spz turned by its library; as decogs-export turns it; the other way round.
    usual, other = (NO_CHANGE, _HALF_A_TURN) if source.file.up == "-Y" else (_HALF_A_TURN, NO_CHANGE)
    best, best_psnr, best_number = splats, -np.inf, 0
    for number, turn in enumerate((usual, exported, other)):
        turned = transformed_splats(splats, turn)
        ingest.place_near_planes(turned.means)
        psnr = mean_psnr(kernel, turned, ingest.views, frame.training)
        if psnr > best_psnr:
            best, best_psnr, best_number = turned, psnr, number
    ingest.place_near_planes(best.means)
    return best, best_number > 0


def _on_lattice(
    kernel: TrainingKernel, ingest: Ingest, frame: RigFrame, settings: EncodeSettings, splats: Splats
) -> tuple[Attributes, Lattice, float, float]:
    """Lattice points, their lattice, its scale, and the dB that they cost."""
    extent, centre = robust_extent(splats.means)
    whole = mean_psnr(kernel, splats, ingest.views, frame.training)
    for halvings in range(_MAX_HALVINGS + 1):
        scale = settings.lattice_scale / 2**halvings
        lattice = default_lattice(extent, centre=centre, scale=scale)
        points = quantise(splats, lattice)
        points = trim_sh_degree(points) if settings.detect_per_frame else points
        lost = whole - mean_psnr(kernel, dequantise(points, lattice), ingest.views, frame.training)
        if lost <= MAX_ROUNDING_LOSS_DB:
            break
    return points, lattice, scale, lost


def _fits(splats: Splats, lattice: Lattice) -> NDArray[np.bool_]:
    """Gaussians whose values have integers of 31 bits; turning a world does not take them beyond 32."""
    largest = [
        np.abs(splats.means.astype(np.float64) - lattice.origin).max(axis=1) / min(lattice.means),
        np.abs(splats.log_scales).max(axis=1) / lattice.log_scales,
        np.abs(splats.opacity_logits) / lattice.opacity_logits,
        np.abs(splats.sh).reshape(len(splats), -1).max(axis=1) / min(lattice.sh_dc, lattice.sh_rest),
    ]
    return np.asarray(np.max(largest, axis=0) <= _LARGEST_INTEGER)


def _left_out(count: int, why: str) -> list[str]:
    return [f"{count} of its Gaussians {why}, and are left out"] if count else []
