"""A very wide pinhole picture as faces of a cube around its camera, each a narrower pinhole picture.

EWA splatting draws a Gaussian as the affine image of its middle. Far from the axis that is wrong: at 75 degrees a
Gaussian of a tenth of its distance reaches over half the picture, as a veil before everything. Pictures with corners
more than 60 degrees off the axis (`is_wide`) are therefore drawn face by face, at the same focal lengths, and joined.
Figures and what was rejected: encoder/DESIGN.md, "Very wide lenses".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, is_wide, ray_slopes
from decogs.formats.splats import FloatArray

_MARGIN = 4
"""Pixels of a face around those that are shown: the footprint of interpolation, and of SSIM's window."""
_CUBIC = 2
"""Pixels on either side that cubic interpolation reads."""
_REMAP_LIMIT = 32766.0
"""The last pixel of the largest picture that ``cv2.remap`` takes."""
_AXES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    ],
    np.float64,
)
"""Of each face its axes (right, down, forward) in the camera's: ahead, right, left, below, above."""
MOST_FACES = len(_AXES)
"""That a wide picture is drawn in."""


class Planes(Protocol):
    """What a pinhole sees: image (H, W, 3), alpha and depth (H, W), as of a Rendering."""

    @property
    def image(self) -> FloatArray: ...
    @property
    def alpha(self) -> FloatArray: ...
    @property
    def depth(self) -> FloatArray: ...


@dataclass(frozen=True)
class Face:
    """A part of a wide picture.

    ``camera``: that draws it. ``window``: rows and columns of the wide picture that hold its part. ``u``, ``v``: where
    the window's pixels lie in the face's picture, counted from the centre of the first one; ``own`` (h, w): which of
    them it shows. ``wide_u``, ``wide_v``: where the face's pixels lie in the wide picture, and ``shown`` (H, W) which
    of them are this face's. ``depth`` (h, w): depth along the wide picture's axis over that along its own.
    """

    camera: Camera
    window: tuple[slice, slice]
    u: FloatArray
    v: FloatArray
    own: NDArray[np.bool_]
    wide_u: FloatArray
    wide_v: FloatArray
    shown: NDArray[np.bool_]
    depth: FloatArray

    def put(self, picture: FloatArray, into: FloatArray, *, depth: bool = False) -> None:
        """Copies the face's ``picture`` (H, W) or (H, W, C), or its ``depth``, to where it belongs in the wide one."""
        import cv2

        how = cv2.INTER_NEAREST if depth else cv2.INTER_CUBIC  # depths are not mixed across edges
        seen = cv2.remap(picture, self.u, self.v, how, borderMode=cv2.BORDER_REPLICATE)
        into[self.window][self.own] = (seen * self.depth if depth else seen)[self.own]

    def put_all(self, part: Planes, whole: Planes) -> None:
        """Copies the face's image, opacity and depth to where they belong in the ``whole`` wide ones."""
        self.put(part.image, whole.image)
        self.put(part.alpha, whole.alpha)
        np.clip(whole.alpha, 0, 1, out=whole.alpha)  # cubic interpolation overshoots
        self.put(part.depth, whole.depth, depth=True)

    def of(self, wide: FloatArray) -> FloatArray:
        """What a ``wide`` picture (H, W) or (H, W, C) has in the face's pixels."""
        import cv2

        return np.asarray(
            cv2.remap(wide, self.wide_u, self.wide_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
        )

    def marks(self, wide: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The face's own pixels (H, W) that are marked in a ``wide`` picture (H, W)."""
        column = np.clip(np.rint(self.wide_u), 0, wide.shape[1] - 1).astype(np.int64)
        row = np.clip(np.rint(self.wide_v), 0, wide.shape[0] - 1).astype(np.int64)
        return np.asarray(self.shown & wide[row, column])

    def needed(self, wide: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The pixels (H, W) of which the marked ones of a ``wide`` picture (H, W) are interpolated."""
        import cv2

        across = np.ones((2 * _CUBIC + 1, 2 * _CUBIC + 1), np.uint8)
        return np.asarray(cv2.dilate(self.marks(wide).astype(np.uint8), across) > 0)


def faces_of(camera: Camera) -> Sequence[Face]:
    """The faces of a wide pinhole ``camera``; none of another one."""
    if not is_wide(camera):
        return ()
    level = replace(camera, name="", world_to_camera=np.eye(4), near=0.0)
    faces = _faces(level.width, level.height, level.fx, level.fy, level.cx, level.cy)
    return [replace(face, camera=_placed(face.camera, axes, camera)) for face, axes in faces]


@lru_cache(maxsize=4)
def _faces(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> tuple[tuple[Face, NDArray[np.float64]], ...]:
    """The faces of a camera at the world's origin, with their axes: poses do not matter to the maps."""
    camera = Camera("", width, height, fx, fy, cx, cy, np.eye(4))
    x = ray_slopes(camera, np.arange(width) + 0.5, np.zeros(width))[0][None, :]
    y = ray_slopes(camera, np.zeros(height), np.arange(height) + 0.5)[1][:, None]
    level = np.abs(x) >= np.abs(y)
    shown = (
        (np.abs(x) <= 1) & (np.abs(y) <= 1),
        (x > 1) & level,
        (x < -1) & level,
        (y > 1) & ~level,
        (y < -1) & ~level,
    )
    found = [(_face(camera, x, y, own, axes), axes) for own, axes in zip(shown, _AXES, strict=True) if own.any()]
    return tuple(found)


def _face(
    camera: Camera,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    own: NDArray[np.bool_],
    axes: NDArray[np.float64],
) -> Face:
    """``x`` (1, W), ``y`` (H, 1): slopes of the wide picture's rays, of which it shows its ``own`` (H, W)."""
    rows, columns = np.flatnonzero(own.any(axis=1)), np.flatnonzero(own.any(axis=0))
    window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    own, x, y = own[window], x[:, window[1]], y[window[0]]
    right, down, ahead = (axis[0] * x + axis[1] * y + axis[2] for axis in axes)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * right / ahead, camera.fy * down / ahead
    left, top = (int(np.floor(places[own].min())) - _MARGIN for places in (u, v))
    right, bottom = (int(np.ceil(places[own].max())) + _MARGIN for places in (u, v))
    drawn = replace(camera, width=right - left, height=bottom - top, cx=float(-left), cy=float(-top))
    across, along = ray_slopes(drawn, *np.meshgrid(np.arange(drawn.width) + 0.5, np.arange(drawn.height) + 0.5))
    outwards = np.stack([across, along, np.ones_like(across)], axis=-1)
    back = (outwards[..., None, :] * axes.T).sum(axis=-1)
    before = back[..., 2] > 1e-3
    with np.errstate(divide="ignore", invalid="ignore"):
        wide_u = np.where(before, camera.fx * back[..., 0] / back[..., 2] + camera.cx - 0.5, -1.0)
        wide_v = np.where(before, camera.fy * back[..., 1] / back[..., 2] + camera.cy - 0.5, -1.0)
    inside = (wide_u >= -0.5) & (wide_u <= camera.width - 0.5) & (wide_v >= -0.5) & (wide_v <= camera.height - 0.5)
    shown = before & inside & (np.abs(outwards[..., :2]).max(axis=-1) <= 1)
    return Face(
        camera=drawn,
        window=window,
        u=np.where(own, u - left - 0.5, 0).astype(np.float32),
        v=np.where(own, v - top - 0.5, 0).astype(np.float32),
        own=own,
        wide_u=np.clip(wide_u, -2.0, _REMAP_LIMIT).astype(np.float32),
        wide_v=np.clip(wide_v, -2.0, _REMAP_LIMIT).astype(np.float32),
        shown=shown,
        depth=np.where(own, 1 / np.where(own, ahead, 1), 0).astype(np.float32),
    )


def _placed(face: Camera, axes: NDArray[np.float64], camera: Camera) -> Camera:
    """The face's camera where the wide one stands."""
    pose = np.eye(4)
    pose[:3] = axes @ camera.world_to_camera[:3]
    return replace(face, name=camera.name, world_to_camera=pose, near=camera.near)
