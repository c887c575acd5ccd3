"""A lens that the calibration does not know well: its k1, from one picture and the scene as it should be seen."""

from __future__ import annotations

import numpy as np

from decogs.decoder.lens import Undistortion, with_k1
from decogs.formats.cameras import Camera, as_pinhole, scale_camera
from decogs.formats.splats import FloatArray

from .colour import odds_shift, tukey_weights, without_odds
from .shake import pixel_grid, resized

_LEVELS = (0.25, 0.5, 1.0)
_ROUNDS = 5
_LARGEST = 0.5


def estimate_k1(recorded: FloatArray, shown: FloatArray, camera: Camera) -> float:
    """What must be added to the k1 of the camera's lens for its ``recorded`` picture to lie over the ``shown`` one.

    Both (3, H, W) of the camera's size: what it recorded, and the scene through ``as_pinhole(camera)``, best trained
    without this camera, since a scene bends to the pictures that it is trained on. Gauss-Newton on the gradients of the
    shown picture, coarse to fine, with robust weights; colours may differ. At most 0.5 in magnitude. Raises UsageError
    for a fisheye.
    """
    k1 = 0.0
    for level in _LEVELS:
        small = scale_camera(camera, level)
        target, source = resized(shown, small), resized(recorded, small)
        x, y = pixel_grid(small)
        down, across = np.gradient(target, axis=(1, 2))
        column = (across * np.float32(small.fx) * x + down * np.float32(small.fy) * y) * (x * x + y * y)
        for _ in range(_ROUNDS):
            lens = Undistortion(with_k1(small, k1), as_pinhole(small))
            straight = np.ascontiguousarray(lens.apply(source.transpose(1, 2, 0)).transpose(2, 0, 1))
            valid = lens.valid.astype(np.float32)
            red, green, blue = np.exp(odds_shift(straight, target, valid).shift).tolist()
            error = without_odds(straight, (red, green, blue)) - target
            weights = tukey_weights(error) * valid
            square = float((weights * column * column).sum(dtype=np.float64))
            step = float((weights * column * error).sum(dtype=np.float64)) / max(square, 1e-12)
            k1 = float(np.clip(k1 - step, -_LARGEST, _LARGEST))
    return k1
