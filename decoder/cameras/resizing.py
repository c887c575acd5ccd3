"""Pictures at the size of a camera, which may be smaller than they were recorded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray


def resized(picture: FloatArray, camera: Camera) -> FloatArray:
    """The picture (3, H, W) at the camera's size, each pixel the mean of those that it covers."""
    if picture.shape[1:] == (camera.height, camera.width):
        return picture
    return np.stack([resized_plane(plane, camera) for plane in picture])


def resized_plane(plane: FloatArray, camera: Camera) -> FloatArray:
    """One plane (H, W) at the camera's size."""
    import cv2

    return np.asarray(cv2.resize(plane, (camera.width, camera.height), interpolation=cv2.INTER_AREA), np.float32)


def recorded_pixels(recorded: FloatArray | None, camera: Camera) -> NDArray[np.bool_]:
    """The pixels (H, W) of ``camera`` that were recorded as a whole; None means all."""
    if recorded is None:
        return np.ones((camera.height, camera.width), bool)
    return np.asarray(resized_plane(recorded, camera) > 0.999)
