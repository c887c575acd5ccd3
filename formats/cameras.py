"""The camera vocabulary: one calibrated camera, OpenCV axes (x right, y down, z forward), pixel centres at .5.

A point X in the world lies at ``world_to_camera @ (X, 1)`` in the camera. Without distortion it falls on
``u = fx * x / z + cx``, ``v = fy * y / z + cy``, measured from the top left corner of the picture, so that the
centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MAX_SIDE = 1 << 16
"""Pixels along a side of the largest camera of a rig or a viewer."""

WIDEST_CORNER = 1.75
"""Tangent of the angle between a pinhole's axis and its farthest corner up to which its picture is drawn whole."""

DistortionModel = Literal["none", "opencv", "fisheye"]


@dataclass(frozen=True)
class Camera:
    """One fixed camera of a rig.

    ``world_to_camera`` is (4, 4) float64, rigid, in world units. ``distortion`` holds the coefficients in OpenCV's
    order: (k1, k2, p1, p2[, k3[, k4, k5, k6]]) for "opencv", (k1, k2, k3, k4) for "fisheye", empty for "none".
    Width, height, fx, fy, cx, cy in pixels. Nothing whose depth is below ``near`` (world units) is drawn: a rig's
    cameras see each other's housings, and a housing must not cover the view of the camera inside it.
    """

    name: str
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: NDArray[np.float64]
    distortion_model: DistortionModel = "none"
    distortion: tuple[float, ...] = ()
    near: float = 0.0


def camera_centre(camera: Camera) -> NDArray[np.float64]:
    """Position of the camera in the world, shape (3,)."""
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    return -turned(rotation.T, translation)


def rig_extent(cameras: Sequence[Camera]) -> float:
    """Size of a rig, 1.1 times the largest distance of a camera from their mean."""
    centres = np.array([camera_centre(camera) for camera in cameras])
    return float(1.1 * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())


def turned(rotation: NDArray[np.float64], vectors: NDArray[np.floating]) -> NDArray[np.float64]:
    """``rotation @ v`` for vectors v (..., 3), summed in a fixed order.

    A BLAS picks its code, and with it the last bits, by the processor; what is encoded must not depend on that.
    """
    x, y, z = (vectors[..., axis, None] for axis in range(3))
    return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + z * rotation[:, 2])


def in_camera(camera: Camera, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """World points (..., 3) in the camera's axes."""
    return turned(camera.world_to_camera[:3, :3], points) + camera.world_to_camera[:3, 3]


def project(camera: Camera, points: NDArray[np.floating]) -> tuple[NDArray[np.float64], ...]:
    """Columns u, rows v and depths (P,) of world points (P, 3); u and v mean nothing where the depth is not above 0."""
    x, y, depth = np.moveaxis(in_camera(camera, points), -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy, depth


def in_picture(
    camera: Camera, u: NDArray[np.floating], v: NDArray[np.floating], depth: NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Whether projected points lie before the camera and inside its picture."""
    return np.asarray((depth > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))


def ray_slopes(camera: Camera, u: NDArray[Any], v: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x / z and y / z of the rays through pixel positions, in the camera's axes; without distortion."""
    return (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy


def ray_directions(camera: Camera, u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.float64]:
    """World directions (..., 3), of depth 1, of the rays through pixel positions; without distortion."""
    x, y = ray_slopes(camera, u, v)
    return turned(camera.world_to_camera[:3, :3].T, np.stack([x, y, np.ones_like(x)], axis=-1))


def scale_camera(camera: Camera, scale: float) -> Camera:
    """The same camera at ``scale`` times its resolution; sizes are rounded and at least one pixel."""
    width = max(1, round(camera.width * scale))
    height = max(1, round(camera.height * scale))
    sx, sy = width / camera.width, height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * sx,
        fy=camera.fy * sy,
        cx=camera.cx * sx,
        cy=camera.cy * sy,
    )


def is_distorted(camera: Camera) -> bool:
    """Whether the camera's lens bends anything. A fisheye does without coefficients, too: it is equidistant then."""
    return camera.distortion_model == "fisheye" or any(camera.distortion)


def is_wide(camera: Camera) -> bool:
    """Whether a corner of the pinhole ``camera`` is so far off its axis, 60 degrees, that it is drawn in parts."""
    across = max(camera.cx, camera.width - camera.cx) / camera.fx
    down = max(camera.cy, camera.height - camera.cy) / camera.fy
    return bool(np.hypot(across, down) > WIDEST_CORNER)


def as_pinhole(camera: Camera) -> Camera:
    """The same camera without its lens distortion: what training renders and the undistorted picture shows."""
    return replace(camera, distortion_model="none", distortion=())
