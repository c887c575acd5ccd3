"""A camera that turns about its centre: its pose in a frame, and the picture as the calibrated pose would have it.

A turn moves pixels by a homography, whatever the scene's depth, so the picture can be compensated exactly. The pose
is found by Gauss-Newton on the gradients of the rendered view, coarse to fine, with robust weights (Lucas and Kanade
1981).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.resizing import resized
from decogs.formats.cameras import Camera, ray_slopes, scale_camera
from decogs.formats.splats import FloatArray

from .colour import tukey_weights

F64 = NDArray[np.float64]

_PYRAMID_SCALES = (0.25, 0.5, 1.0)
_MAX_SHAKE_PIXELS = 200_000
"""The finest level has at most so many: a hundredth of a pixel is found there, which is enough in larger pictures."""

_STEPS_PER_LEVEL = 4
"""Steps per level; each one leaves a few per cent of the error of the one before."""

_MIN_SIDE_PIXELS = 24


def undo_turn(picture: FloatArray, camera: Camera, rotation: F64) -> FloatArray:
    """The picture (3, H, W) of the turned pinhole ``camera`` as the calibrated pose sees it; edges are continued.

    ``rotation`` (3, 3) takes directions in the turned camera to those in the calibrated one.
    """
    # OpenCV counts from the centre of the first pixel.
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    inverse = np.array([[1 / fx, 0, -cx / fx], [0, 1 / fy, -cy / fy], [0, 0, 1]])
    warped: Any = cv2.warpPerspective(
        np.ascontiguousarray(picture.transpose(1, 2, 0)),
        _product(_product(k, rotation.T), inverse),
        (camera.width, camera.height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.ascontiguousarray(warped.transpose(2, 0, 1))


def estimate_turn(recorded: FloatArray, rendered: FloatArray, camera: Camera, valid: FloatArray | None = None) -> F64:
    """The rotation (3, 3) by which the camera was turned when it recorded the picture, against the ``rendered`` view.

    Both (3, H, W) of the pinhole ``camera``, of like colours. ``valid`` (H, W) is 0 where nothing was recorded.
    """
    rotation, finest = np.eye(3), min(1.0, np.sqrt(_MAX_SHAKE_PIXELS / rendered[0].size))
    for level in _PYRAMID_SCALES:
        small = scale_camera(camera, level * finest)
        if level < 1 and min(small.width, small.height) < _MIN_SIDE_PIXELS:
            continue
        target, source = resized(rendered, small), resized(recorded, small)
        mask = None if valid is None else cv2.resize(valid, (small.width, small.height)) > 0.99
        columns = _flow_gradients(target, small)
        for _ in range(_STEPS_PER_LEVEL):
            step = _step(undo_turn(source, small, rotation) - target, columns, mask)
            rotation = _product(_exponential(step), rotation)
    return rotation


def angles_of(rotation: F64) -> tuple[float, float, float]:
    """Yaw, pitch and roll in radians of Ry(yaw) Rx(pitch) Rz(roll)."""
    yaw = np.arctan2(rotation[0, 2], rotation[2, 2])
    pitch = np.arcsin(np.clip(-rotation[1, 2], -1, 1))
    return float(yaw), float(pitch), float(np.arctan2(rotation[1, 0], rotation[1, 1]))


def _step(error: FloatArray, columns: list[FloatArray], mask: NDArray[np.bool_] | None) -> F64:
    """The turn, as a vector, that explains most of the error; sums in a fixed order, so that no BLAS decides bits."""
    weights = tukey_weights(error)
    if mask is not None:
        weights = weights * mask
    normal = np.array([[(weights * a * b).sum(dtype=np.float64) for b in columns] for a in columns])
    right = np.array([(weights * a * error).sum(dtype=np.float64) for a in columns])
    # A view without texture says nothing about some turn: it then stays at none.
    a, b, c = normal + 1e-9 * max(np.trace(normal), 1e-12) * np.eye(3)
    minors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    return np.asarray((minors * right[:, None]).sum(axis=0) / (a * minors[0]).sum())


def _flow_gradients(picture: FloatArray, camera: Camera) -> list[FloatArray]:
    """How the colours change with a turn about x, y and z, each (3, H, W) per radian."""
    x, y = pixel_grid(camera)
    down, across = np.gradient(picture, axis=(1, 2))
    across, down = across * np.float32(camera.fx), down * np.float32(camera.fy)
    return [
        -across * (x * y) - down * (1 + y * y),
        across * (1 + x * x) + down * (x * y),
        -across * y + down * x,
    ]


def pixel_grid(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Normalised coordinates x (1, W) and y (H, 1) of the camera's pixel centres."""
    x, y = ray_slopes(camera, np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return x.astype(np.float32)[None, :], y.astype(np.float32)[:, None]


def _exponential(turn: F64) -> F64:
    return np.asarray(cv2.Rodrigues(turn)[0], np.float64)


def _product(a: F64, b: F64) -> F64:
    """a @ b of 3x3 matrices, summed in a fixed order."""
    return np.asarray((a[:, :, None] * b[None, :, :]).sum(axis=1))
