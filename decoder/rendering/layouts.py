"""Pictures of more than one rendering: a stereo pair side by side, and an equirectangular 360 degree view.

*Stereo*: two parallel cameras, half the baseline to the left and to the right of the view's; left eye on the left.

*Equirectangular*: all around the view's position, level by the world's up, the view's direction in the middle; as
many pixels to a degree there as the view has in its centre. Made of six cube faces, which are blended where they meet:
a Gaussian's ellipse is another in each (EWA splatting is linear about a Gaussian's centre), so that large near ones
would show a seam.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.geometry.up_direction import up_of
from decogs.formats.splats import Splats

from ..cameras.fields import pose_of
from ..cameras.moves import looking
from .views import render_view, scaled_view

if TYPE_CHECKING:
    from ..rasterise import Rendering

WIDEST = 8192
"""Pixels across an equirectangular picture."""

_WIDEST_EYES = 1e12
"""As far from the origin as a camera file may put a camera."""

_OVERLAP = 0.1
"""Of a face's half width, to either side of an edge, in which one face is blended into the next."""

_MARGIN = 2
"""Pixels around a face for cubic interpolation."""


@dataclass(frozen=True)
class Stereo:
    """Two eyes ``baseline`` world units apart, side by side."""

    baseline: float

    def check(self) -> None:
        """Raises UsageError for a baseline that is none."""
        if not 0 < self.baseline <= _WIDEST_EYES:
            raise UsageError(
                f"`stereo` {self.baseline:g}: give the distance of the eyes in world units, "
                f"above 0 and at most {_WIDEST_EYES:g}"
            )

    def picture_of(self, camera: Camera) -> Camera:
        """A camera of the picture's size."""
        return scaled_view(replace(camera, width=2 * camera.width), 1.0)

    def render(self, header: StreamHeader, splats: Splats, camera: Camera, how: dict[str, Any]) -> Rendering:
        """The picture of a view's own camera; ``how`` as in ``render_view``."""
        left, right = (
            render_view(header, splats, moved_aside(camera, side * self.baseline / 2), **how) for side in (-1, 1)
        )
        return _joined([left, right])


@dataclass(frozen=True)
class Equirectangular:
    """All around, 2 to 1."""

    def check(self) -> None:
        """Nothing can be wrong."""

    def picture_of(self, camera: Camera) -> Camera:
        """A camera of the picture's size."""
        height = max(1, round(np.pi * camera.fx))
        if 2 * height > WIDEST:
            raise UsageError(
                f"a 360 degree picture would be {2 * height} pixels wide, and {WIDEST} is the limit; "
                "choose a smaller `scale`"
            )
        return scaled_view(replace(camera, width=2 * height, height=height), 1.0)

    def render(self, header: StreamHeader, splats: Splats, camera: Camera, how: dict[str, Any]) -> Rendering:
        """The picture of a view's own camera; ``how`` as in ``render_view``."""
        import cv2

        from ..rasterise import Rendering

        height = self.picture_of(camera).height
        rays = _rays(height)
        level = level_pose(camera, up_of(header.cameras))
        image, weights = np.zeros((height, 2 * height, 3), np.float32), np.zeros((height, 2 * height, 1), np.float32)
        alpha, distance = np.zeros((height, 2 * height), np.float32), np.zeros((height, 2 * height), np.float32)
        for turn in _TURNS:
            face = _face_camera(camera, turn @ level, height)
            seen = render_view(header, splats, face, **how)
            x, y, z = np.tensordot(turn.astype(np.float32), rays, 1)
            before = z > 1e-3
            z[~before] = 1
            x, y = x / z, y / z
            aside = np.maximum(np.abs(x), np.abs(y))
            # OpenCV's pixels have whole numbers in their middle.
            u, v = x * face.fx + (face.cx - 0.5), y * face.fy + (face.cy - 0.5)
            weight = np.clip((1 + _OVERLAP - aside) / (2 * _OVERLAP), 0, 1) * before
            weights += weight[..., None]
            image += weight[..., None] * cv2.remap(seen.image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            alpha += weight * cv2.remap(seen.alpha, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            deepest = before & (aside <= 1)
            depth = cv2.remap(seen.depth, u, v, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
            distance[deepest] = (depth / z)[deepest]  # rays have length 1
        return Rendering(image / weights, np.clip(alpha / weights[..., 0], 0, 1), distance)


Layout = Stereo | Equirectangular


def moved_aside(camera: Camera, distance: float) -> Camera:
    """The camera, moved along its own x axis."""
    pose = camera.world_to_camera.copy()
    pose[0, 3] -= distance
    return replace(camera, world_to_camera=pose)


def level_pose(camera: Camera, up: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-to-camera rotation that looks where the camera does, as far as it is level, with ``up`` upwards."""
    forward = camera.world_to_camera[2, :3]
    level = forward - (forward @ up) * up
    if np.linalg.norm(level) < 1e-6:  # straight up or down: what is up in its picture is ahead
        level = -camera.world_to_camera[1, :3]
    return looking(np.zeros(3), level, up)[:3, :3]


_TURNS = tuple(
    np.array(rows, np.float64)
    for rows in (
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],  # ahead
        [[0, 0, -1], [0, 1, 0], [1, 0, 0]],  # right
        [[-1, 0, 0], [0, 1, 0], [0, 0, -1]],  # behind
        [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],  # left
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],  # above
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],  # below
    )
)
"""From the level axes to each face's: x right, y down, z into the face."""


def _rays(height: int) -> NDArray[np.float32]:
    """The direction (3, H, 2 H) of every pixel in level axes, length 1."""
    longitude = (((np.arange(2 * height) + 0.5) / height - 1) * np.pi).astype(np.float32)
    latitude = ((0.5 - (np.arange(height) + 0.5) / height) * np.pi).astype(np.float32)
    across = np.cos(latitude)[:, None]
    down = np.repeat(-np.sin(latitude)[:, None], 2 * height, axis=1)
    return np.stack([across * np.sin(longitude), down, across * np.cos(longitude)])


def _face_camera(camera: Camera, rotation: NDArray[np.float64], height: int) -> Camera:
    """A face with as many pixels to a degree in its centre as the picture, and the overlap around it."""
    focal = max(1.0, height / np.pi)
    whole = 2 * int(np.ceil(focal * (1 + _OVERLAP))) + 2 * _MARGIN
    pose = pose_of(rotation, camera_centre(camera))
    return Camera(camera.name, whole, whole, focal, focal, whole / 2, whole / 2, pose, near=camera.near)


def _joined(eyes: list[Rendering]) -> Rendering:
    from ..rasterise import Rendering

    planes = (np.concatenate([getattr(eye, name) for eye in eyes], axis=1) for name in ("image", "alpha", "depth"))
    return Rendering(*planes)
