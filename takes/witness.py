"""How far a view of a scene agrees with what cameras recorded from elsewhere: what can be known of it without a truth.

The recorded pictures of the nearest cameras are moved into the view by the depth that is drawn there. Where they agree
with what is drawn, geometry and colours are right; where no camera sees a place, nothing bears witness to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.cameras.lens import Undistortion
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rendering.unseen import places, seen_by
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera, as_pinhole, camera_centre, scale_camera
from decogs.formats.pictures.reading import Picture
from decogs.formats.splats import FloatArray, Splats
from decogs.rig.pictures.ingest import display_referred

F64 = NDArray[np.float64]

_PICTURE_PIXELS = 40_000
"""About which views are compared: errors of larger structures count for a viewer, and a map has hundreds of views."""
_NEAREST, _AROUND = 3, 4
_SAME_DEPTH = 0.05
"""Share of a depth by which a camera may see another surface and still bear witness to this one."""
_SOLID = 0.5
"""Alpha from which on something is drawn."""
_LEAST_ERROR = 1e-9
_BLOCK = 16
_BAD_ERROR = 10**-2.0
"""Squared, 20 dB."""
_UNSEEN_ERROR = 0.03
"""Squared, of what nobody saw: of 48 left-out views of eleven rigs, blocks are told from others with an AUC of .87."""


@dataclass(frozen=True)
class Witnessed:
    """Of a view: ``agreement`` in dB of what is drawn with what was recorded, over the pixels that a camera saw, whose
    share is ``seen``; ``angle``: degrees to the nearest camera, about what is drawn; ``one_sided``: 0 where the nearest
    cameras are all around, 1 where all are on one side."""

    agreement: float
    seen: float
    angle: float
    one_sided: float


@dataclass(frozen=True, eq=False)
class _Witness:
    camera: Camera
    picture: FloatArray  # (H, W, 3), in the colours of the scene; NaN where nothing was recorded
    depth: FloatArray  # (H, W)


class Witnesses:
    """Cameras that recorded a frame of a stream with this ``header``; ``pictures`` by their names."""

    def __init__(
        self, header: StreamHeader, splats: Splats, pictures: Mapping[str, Picture], *, threads: int = 0
    ) -> None:
        self._header, self._splats, self._threads = header, splats, threads
        cameras = {camera.name: camera for camera in header.cameras}
        self._witnesses = [self._witness(cameras[name], picture) for name, picture in pictures.items()]
        self._places = np.array([camera_centre(each.camera) for each in self._witnesses])

    def depth_seen(self, name: str) -> float:
        """How far away a camera of the rig sees the scene, in the middle of its picture; world units."""
        depth = next(each.depth for each in self._witnesses if each.camera.name == name)
        rows, columns = (slice(size // 4, size - size // 4) for size in depth.shape)
        middle = depth[rows, columns]
        there = middle[middle > 0]
        return float(np.median(there)) if len(there) else 1.0

    def testimony(self, view: Camera) -> tuple[Witnessed, F64]:
        """What cameras say of a view, and the squared error (H, W) of its pixels, NaN where nobody saw them.

        ``view``: of a camera anywhere; a camera of the rig is no witness of its own picture.
        """
        camera = _small(view)
        drawn = self._drawn(camera)
        points = places(camera, drawn.depth.astype(np.float64))
        middle = np.median(points[drawn.depth > 0], axis=0) if (drawn.depth > 0).any() else camera_centre(camera)
        angles = _angles(self._places - middle, camera_centre(camera) - middle)
        nearest = [row for row in np.argsort(angles, kind="stable") if self._witnesses[row].camera.name != view.name]
        errors = [_error(self._witnesses[row], drawn, points) for row in nearest[:_NEAREST]]
        with np.errstate(invalid="ignore"):
            known = np.isfinite(errors)
            error = np.where(known, errors, 0).sum(axis=0) / known.sum(axis=0)
        seen = np.isfinite(error)
        mean = float(error[seen].mean()) if seen.any() else 1.0
        agreement = float(-10 * np.log10(max(mean, _LEAST_ERROR)))
        around = _directions(self._places[nearest[:_AROUND]] - middle) - _directions(camera_centre(camera) - middle)
        one_sided = np.linalg.norm(around.mean(axis=0)) / max(float(np.linalg.norm(around, axis=1).mean()), 1e-9)
        return Witnessed(agreement, float(seen.mean()), float(angles[nearest[0]]), float(one_sided)), error

    def doubted(self, view: Camera) -> NDArray[np.uint8]:
        """The view's picture (H, W, 3), small, red in blocks that are likely below 20 dB or that nobody saw."""
        _, error = self.testimony(view)
        bad = np.repeat(np.repeat(doubtful_blocks(error), _BLOCK, axis=0), _BLOCK, axis=1)
        shown = np.clip(self._drawn(_small(view)).image, 0, 1) * 255
        bad = np.pad(bad, [(0, size - known) for size, known in zip(error.shape, bad.shape, strict=True)], mode="edge")
        return np.where(bad[..., None], 0.5 * shown + np.array([127.0, 20.0, 20.0]), shown).astype(np.uint8)

    def _witness(self, camera: Camera, picture: Picture) -> _Witness:
        plan = Undistortion(camera)
        small = replace(_small(plan.pinhole), name=camera.name)
        size = small.width, small.height
        resized = cv2.resize(display_referred(plan.apply(picture)), size, interpolation=cv2.INTER_AREA)
        recorded = cv2.resize(plan.valid.astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0
        drawn = self._drawn(small)
        # A camera's own exposure and white balance are no error of the scene.
        both = recorded & (drawn.alpha > _SOLID)
        gain = (drawn.image[both].mean(axis=0) + 1e-3) / (resized[both].mean(axis=0) + 1e-3) if both.any() else 1.0
        seen = np.where(recorded[..., None], resized * gain, np.nan)
        return _Witness(small, seen.astype(np.float32), drawn.depth)

    def _drawn(self, camera: Camera) -> Rendering:
        return render_view(self._header, self._splats, camera, threads=self._threads)


def doubtful_blocks(error: F64) -> NDArray[np.bool_]:
    """Which whole blocks of 16x16 pixels are likely below 20 dB, by squared errors (H, W), NaN where nobody saw:
    their mean over what was seen, and what is bad more often than not where nothing was."""
    rows, columns = (size // _BLOCK for size in error.shape)
    blocks = error[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    expected = np.where(np.isfinite(blocks), blocks, _UNSEEN_ERROR).mean(axis=(1, 3))
    return np.asarray(expected > _BAD_ERROR)


def _small(camera: Camera) -> Camera:
    """Its pinhole in a small size, under its name."""
    straight = as_pinhole(camera)
    scale = min(1.0, (_PICTURE_PIXELS / (straight.width * straight.height)) ** 0.5)
    return replace(scale_camera(straight, scale), name=camera.name)


def _error(witness: _Witness, drawn: Rendering, points: F64) -> F64:
    """Squared difference (H, W) of what is drawn and what the witness recorded there; NaN where it does not see it."""
    sees, x, y = seen_by(witness.camera, witness.depth, points, _SAME_DEPTH)
    recorded = cv2.remap(witness.picture, x, y, cv2.INTER_LINEAR)
    error = ((recorded - np.clip(drawn.image, 0, 1)) ** 2).mean(axis=-1)
    return np.where(sees & (drawn.depth > 0), error, np.nan)


def _directions(ways: F64) -> F64:
    return np.asarray(ways / np.maximum(np.linalg.norm(ways, axis=-1, keepdims=True), 1e-12))


def _angles(directions: F64, other: F64) -> F64:
    """Degrees (N,) between directions (N, 3) and another one."""
    return np.asarray(np.degrees(np.arccos(np.clip(_directions(directions) @ _directions(other), -1, 1))))
