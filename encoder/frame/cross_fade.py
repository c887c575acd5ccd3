"""Cross-fade: the last frames of a closed segment blend into the scene that the next one begins with.

Two trainings of one frame err differently where no camera looks, and a segment's start is trained from the first
keyframe, not from the frame before. So the next segment is also trained backwards from its start for a few frames. In
these, the Gaussians of the segment that ends are trained towards a mixture of both segments' renderings, from the
cameras and from between them. Figures and rejected alternatives: DESIGN.md, "Closed segments".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, scale_camera, turned
from decogs.formats.splats import Splats, join_splats, take_splats

from ..backends import ATTRIBUTES, FixedView, Optimiser, TrainingKernel
from ..backends.scene_views import SceneViews
from ..settings.frame import FocusWeights, FrameSettings
from ..training.losses import PhotometricLoss, StepLosses, focus_loss
from ..training.method import TrainedFrame
from ..training.schedule import LATE_DECAY, MAX_STRETCH
from ..training.significance import picture_weight
from ..training.view_order import view_order

_MAX_FADE_PIXELS = 240_000
"""Maximum pixels per cross-fade view. Smaller views blur detail: -.4 dB at a fifth of 352x264."""

_STEPS_FACTOR, _RATES_FACTOR = 2, 0.4
"""Of the frame's steps and rates. The mixture differs little from the frame: full rates would train as much noise."""

_LAMBDA_DIVISOR = 2.0
"""Of the frame's rate-distortion lambdas: each change of a fade is small, and must still be coded."""

_MIN_DIFFERENCE = 1.0 / 255
"""Difference of the two scenes in a pixel, colours 0 to 1, above which the pixel is in the fade's focus."""


@dataclass(frozen=True)
class CrossFade:
    """The mixture that a frame is faded towards: the next segment's ``scene`` of the frame, and its ``share``, 0 to 1.

    ``rows``: Gaussians of the scene before the frame that may change for it. ``views``: where the two scenes are
    compared, of `fade_cameras`.
    """

    scene: Splats
    share: float
    rows: NDArray[np.int64]
    views: SceneViews


def fade_cameras(cameras: Sequence[Camera]) -> list[Camera]:
    """The ``cameras``, and others half way between neighbours, with pictures of at most _MAX_FADE_PIXELS.

    Two are neighbours if no third one is nearer to both. One that has a single neighbour, as at the end of an arc, has
    another camera half way in the opposite direction.
    """
    pairs = _neighbours(np.array([camera_centre(camera) for camera in cameras]))
    ends = [index for index in range(len(cameras)) if sum(index in pair for pair in pairs) == 1]
    beyond = [(one, other) for pair in pairs for one, other in (pair, pair[::-1]) if one in ends]
    fade = [replace(camera, name=f"at {camera.name}") for camera in cameras]
    fade += [_between(cameras[one], cameras[other], 0.5) for one, other in pairs]
    fade += [_between(cameras[one], cameras[other], -0.5) for one, other in beyond]
    return [_small(camera) for camera in fade]


def _neighbours(centres: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Pairs of which no third of the ``centres`` (N, 3) is nearer to both (relative neighbourhood graph)."""
    distances = np.linalg.norm(centres[:, None] - centres, axis=2)
    nearer = np.maximum(distances[:, None, :], distances[None, :, :]).min(axis=2) < distances
    return [(i, j) for i in range(len(centres)) for j in range(i) if distances[i, j] > 0 and not nearer[i, j]]


def _between(camera: Camera, other: Camera, share: float) -> Camera:
    """The ``camera`` moved and turned towards the ``other`` by a share of the way; below 0: away from it.

    Rounded, since the last bits of a decomposition depend on the processor.
    """
    rotation, other_rotation = camera.world_to_camera[:3, :3], other.world_to_camera[:3, :3]
    turn = cv2.Rodrigues(turned(other_rotation, rotation).T)[0] * share
    pose = np.eye(4)
    pose[:3, :3] = turned(cv2.Rodrigues(turn)[0], rotation.T).T
    centre = (1 - share) * camera_centre(camera) + share * camera_centre(other)
    pose[:3, 3] = -turned(pose[:3, :3], centre)
    return replace(camera, name=f"{camera.name} {share:+} {other.name}", world_to_camera=np.round(pose, 12))


def _small(camera: Camera) -> Camera:
    return scale_camera(camera, min(1.0, math.sqrt(_MAX_FADE_PIXELS / (camera.width * camera.height))))


def with_exact_changes(settings: FrameSettings) -> FrameSettings:
    """The settings of a frame in a cross-fade."""
    significance = settings.significance
    exact = {name: getattr(significance, name) / _LAMBDA_DIVISOR for name in ("rd_lambda", "colour_rd_lambda")}
    return replace(settings, significance=replace(significance, **exact))


@dataclass(frozen=True)
class _Fading:
    """The Gaussians of a fade: ``old`` ones of ``rows`` of the scene before the frame, then new ones.

    ``values``: theirs as trained so far. ``sensitivity``: of the old ones, as training has it (`TrainedFrame`), 0 for
    those that were not trained. ``detached``: rows of the scene that are not static.
    """

    rows: NDArray[np.int64]
    old: int
    values: Splats
    sensitivity: Splats
    detached: NDArray[np.int64]


def cross_fade(
    kernel: TrainingKernel,
    scene: Splats,
    trained: TrainedFrame,
    fade: CrossFade,
    settings: FrameSettings,
    *,
    extent: float,
    seed: tuple[int, int],
    on_loss: Callable[[str, int, float], None] | None = None,
) -> TrainedFrame:
    """The ``trained`` frame, trained further towards the ``fade``'s mixture.

    ``scene``: of the frame before. ``settings``: of the frame. ``extent``: size of the rig, world units. ``seed``
    determines all randomness. Raises TrainingError for a loss that is not finite.
    """
    fading = _fading(scene, trained, fade)
    losses = _losses(kernel, fade, scene, fading, settings.focus)
    if not losses:
        return trained
    optimiser = kernel.optimiser(fading.values, beta1=settings.beta1, beta2=settings.beta2)
    share = picture_weight([loss for _, loss in losses])
    seen, rates = StepLosses(), replace(settings.rates, means=settings.rates.means * extent)
    order, steps = view_order(len(losses), np.random.default_rng(seed)), _STEPS_FACTOR * settings.joint_iterations
    for step in range(steps):
        view, loss = losses[next(order)]
        view.draw(optimiser, fading.rows)
        value = loss.evaluate_drawn(view)
        seen.add(value, view.camera)
        if on_loss is not None:
            on_loss("fade", step, value.total)
        late = LATE_DECAY ** max(0.0, 2 * step / steps - 1)
        optimiser.step(view.backward(), rates.scaled(_RATES_FACTOR * late), max_stretch=MAX_STRETCH)
    seen.check()
    return _cross_faded(trained, fading, optimiser, share)


def _fading(scene: Splats, trained: TrainedFrame, fade: CrossFade) -> _Fading:
    """The frame's trained Gaussians, and the others that may change for the fade."""
    rows = np.setdiff1d(np.union1d(trained.kept, fade.rows), trained.removed)
    values = take_splats(scene, rows)
    sensitivity = Splats(*(np.zeros_like(getattr(values, name)) for name in ATTRIBUTES))
    trained_rows = np.searchsorted(rows, trained.kept)
    for name in ATTRIBUTES:
        getattr(values, name)[trained_rows] = getattr(trained.values, name)
        if trained.sensitivity is not None:
            getattr(sensitivity, name)[trained_rows] = getattr(trained.sensitivity, name)
    numbered = np.concatenate([rows, np.arange(len(scene), len(scene) + len(trained.added))])
    all_values = join_splats(values, trained.added)
    return _Fading(numbered, len(rows), all_values, sensitivity, np.union1d(rows, trained.removed))


def _losses(
    kernel: TrainingKernel, fade: CrossFade, scene: Splats, fading: _Fading, weights: FocusWeights
) -> list[tuple[FixedView, PhotometricLoss]]:
    """The fade's views in which the two scenes differ, ready to be drawn, and each one's loss against their mixture."""
    losses = []
    fade.views.of(scene).detach(fading.detached)
    for view in fade.views:
        view.draw(fading.values, fading.rows)
        mine, theirs = view.rgb, kernel.forward(fade.scene, view.camera).rgb
        differs = np.abs(theirs - mine).max(axis=0) > _MIN_DIFFERENCE
        if differs.any():
            target = mine + np.float32(fade.share) * (theirs - mine)
            losses.append((view, focus_loss(target, differs, None, weights)))
    return losses


def _cross_faded(trained: TrainedFrame, fading: _Fading, optimiser: Optimiser, share: float) -> TrainedFrame:
    """The frame with the optimiser's values; ``share``: a picture's weight in its losses.

    A value may matter to the scene that hardly matters to the difference of the two: its sensitivity is the larger one
    of the fade's and of the frame's training.
    """
    values, old = optimiser.splats, np.arange(fading.old)
    gradient_sizes = (optimiser.gradient_size(name)[: fading.old] / np.float32(share) for name in ATTRIBUTES)
    sizes = (
        np.maximum(size, getattr(fading.sensitivity, name))
        for name, size in zip(ATTRIBUTES, gradient_sizes, strict=True)
    )
    return replace(
        trained,
        kept=fading.rows[: fading.old],
        values=take_splats(values, old),
        added=take_splats(values, np.arange(fading.old, len(values))),
        sensitivity=Splats(*sizes),
    )
