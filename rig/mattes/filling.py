"""Values of some pixels, spread into the gaps between them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray


def push_pull(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Values (H, W, C) of pixels with weights (H, W) above 0, spread into the gaps between them.

    Push-pull interpolation: a gap gets the weighted mean of growing surroundings, up to the first with any value.
    """
    levels = [(values * weights[..., None], weights)]
    while min(levels[-1][1].shape) > 1 and (levels[-1][1] <= 1e-6).any():
        size = tuple(max(1, side // 2) for side in levels[-1][1].shape[::-1])
        halves = (cv2.resize(whole, size, interpolation=cv2.INTER_AREA) for whole in levels[-1])
        levels.append((_like(next(halves), values), np.asarray(next(halves), np.float32)))
    total, weight = levels[-1]
    filled = np.empty_like(total)
    filled[:] = total.sum(axis=(0, 1)) / max(float(weight.sum()), 1e-12)
    for total, weight in reversed(levels):
        filled = _like(cv2.resize(filled, weight.shape[::-1], interpolation=cv2.INTER_LINEAR), values)
        enough = weight > 1e-6
        filled[enough] = total[enough] / weight[enough, None]
    return filled


def shrunk_and_filled(picture: FloatArray, weights: FloatArray, size: tuple[int, int]) -> FloatArray:
    """The picture (H, W, C) at ``size`` (width, height), going on where it has no ``weights`` (H, W)."""
    shrunk = np.asarray(cv2.resize(weights, size, interpolation=cv2.INTER_AREA), np.float32)
    sums = cv2.resize(picture * weights[..., None], size, interpolation=cv2.INTER_AREA)
    return push_pull(np.asarray(sums / np.maximum(shrunk, 1e-6)[..., None], np.float32), shrunk)


def _like(resized: NDArray[np.generic], values: FloatArray) -> FloatArray:
    """OpenCV's result (H, W) or (H, W, C) with its channels."""
    return np.asarray(resized, np.float32).reshape(*resized.shape[:2], values.shape[2])
