"""The camera vocabulary: one calibrated camera, OpenCV axes (x right, y down, z forward), pixel centres at .5.

A point X in the world lies at ``world_to_camera @ (X, 1)`` in the camera. Without distortion it falls on
``u = fx * x / z + cx``, ``v = fy * y / z + cy``, measured from the top left corner of the picture, so that the
centre of the first pixel is (0.5, 0.5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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


def turned(rotation: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """``rotation @ v`` for vectors v (..., 3), summed in a fixed order.

    A BLAS picks its code, and with it the last bits, by the processor; what is encoded must not depend on that.
    """
    x, y, z = (vectors[..., axis, None] for axis in range(3))
    return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + z * rotation[:, 2])


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


def as_pinhole(camera: Camera) -> Camera:
    """The same camera without its lens distortion: what training renders and the undistorted picture shows."""
    return replace(camera, distortion_model="none", distortion=())
