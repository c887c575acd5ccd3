"""What no camera of the rig has seen of a picture, which may then be left out instead of shown as a smear.

A place is seen where a camera that was trained on sees a surface as far away as that place is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.colours.srgb import Colour
from decogs.formats.splats import FloatArray, Splats

from ..cameras.lens import Redistortion, Undistortion
from ..output.exr import coverage
from .views import max_pairs

if TYPE_CHECKING:
    from ..rasterise import Rendering

F64 = NDArray[np.float64]
Flags = NDArray[np.bool_]

_PIXELS = 100_000
"""About which a picture is looked at for this: what nobody saw is no detail."""
_SAME_DEPTH = 0.1
"""Share of a depth by which a camera may see another surface."""
_SPECKS = 5
"""Pixels across which single ones follow their neighbours."""


@dataclass(frozen=True, eq=False)
class _Eye:
    """A camera as training saw it: a pinhole, and which pixels (H, W) of its picture were ``recorded``."""

    pinhole: Camera
    recorded: Flags

    @classmethod
    def of(cls, camera: Camera) -> _Eye:
        import cv2

        plan = Undistortion(camera)
        pinhole = _small(plan.pinhole)
        size = pinhole.width, pinhole.height
        recorded = cv2.resize(plan.valid.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
        return cls(pinhole, np.asarray(recorded) > 0)


class Sight:
    """What the cameras of a stream's rig that were trained on see of its frames."""

    def __init__(self, header: StreamHeader, threads: int, max_memory: int | None = None) -> None:
        self._header, self._threads, self._max_memory = header, threads, max_memory
        self._eyes = [_Eye.of(each) for each in header.cameras if each.name not in header.held_out]
        self._splats: Splats | None = None
        self._depths: list[FloatArray] = []

    def left_out(self, splats: Splats, plan: Redistortion, picture: Rendering, background: Colour | None) -> Rendering:
        """The ``picture`` of a view without what nobody saw: over the ``background``, or over nothing where it is None.

        Alpha and depth are 0 where nobody saw. Surfaces of a whole scene over nothing are solid, as those of an EXR,
        and look as they do in the picture.
        """
        from ..rasterise import Rendering

        seen = plan.apply(self._seen(splats, plan.render_camera))
        depth = np.where(seen >= 0.5, picture.depth, np.float32(0))
        if background is not None:
            behind = np.asarray(background, np.float32)
            return Rendering(behind + seen[..., None] * (picture.image - behind), picture.alpha * seen, depth)
        if self._header.subject:
            return Rendering(picture.image * seen[..., None], picture.alpha * seen, depth)
        alpha = coverage(picture.alpha) * seen
        return Rendering(picture.image * alpha[..., None], alpha, depth)

    def _seen(self, splats: Splats, pinhole: Camera) -> FloatArray:
        """How far the pixels (H, W) of a pinhole's picture show what was seen, 0 to 1."""
        import cv2

        if splats is not self._splats:
            self._splats = splats
            self._depths = [np.where(eye.recorded, self._depth(splats, eye.pinhole), 0) for eye in self._eyes]
        camera = _small(pinhole)
        depth = self._depth(splats, camera)
        points = places(camera, depth)
        seen = np.zeros(depth.shape, bool)
        for eye, surface in zip(self._eyes, self._depths, strict=True):
            seen |= seen_by(eye.pinhole, surface, points, _SAME_DEPTH)[0]
        smooth = cv2.medianBlur((seen & (depth > 0)).astype(np.uint8), _SPECKS).astype(np.float32)
        return np.asarray(cv2.resize(smooth, (pinhole.width, pinhole.height), interpolation=cv2.INTER_LINEAR))

    def _depth(self, splats: Splats, camera: Camera) -> FloatArray:
        from ..rasterise import render

        pairs = max_pairs(self._header, len(splats), Redistortion(camera), self._max_memory)
        return render(splats, camera, threads=self._threads, max_pairs=pairs).depth


def _small(pinhole: Camera) -> Camera:
    scale = min(1.0, (_PIXELS / (pinhole.width * pinhole.height)) ** 0.5)
    return replace(scale_camera(pinhole, scale), name=pinhole.name)


def places(pinhole: Camera, depth: NDArray[Any]) -> F64:
    """Where in the world (H, W, 3) the surfaces of a pinhole's picture are, whose depths (H, W) are given."""
    y, x = np.mgrid[0 : pinhole.height, 0 : pinhole.width] + 0.5
    rays = np.stack([(x - pinhole.cx) / pinhole.fx, (y - pinhole.cy) / pinhole.fy, np.ones_like(x)], axis=-1)
    rotation, shift = pinhole.world_to_camera[:3, :3], pinhole.world_to_camera[:3, 3]
    return np.asarray((rays * depth[..., None] - shift) @ rotation, np.float64)


def seen_by(
    pinhole: Camera, surface: FloatArray, points: F64, tolerance: float
) -> tuple[Flags, FloatArray, FloatArray]:
    """Whether a pinhole whose picture has the depths ``surface`` sees one at the ``points`` (H, W, 3), to a share of
    their depth; and where in its picture they lie, x and y in pixels from the middle of the first one."""
    import cv2

    own = points @ pinhole.world_to_camera[:3, :3].T + pinhole.world_to_camera[:3, 3]
    z = np.where(own[..., 2] > 0, own[..., 2], np.nan)
    x, y = (
        (own[..., axis] / z * focal + centre - 0.5).astype(np.float32)
        for axis, focal, centre in ((0, pinhole.fx, pinhole.cx), (1, pinhole.fy, pinhole.cy))
    )
    inside = (x >= 0) & (x <= pinhole.width - 1) & (y >= 0) & (y <= pinhole.height - 1)
    there = cv2.remap(surface, x, y, cv2.INTER_LINEAR)
    return inside & (np.abs(there - z) < tolerance * z), x, y
