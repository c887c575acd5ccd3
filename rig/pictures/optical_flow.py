"""Optical flow between two pictures of a camera, there and back.

Source: DIS (Kroeger 2016, "Fast optical flow using dense inverse search"), OpenCV's. It depends on the number of
OpenCV's threads: to be called `side_by_side`.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..numerics import floats

MAX_APART_PIXELS = 1.0
"""By which flow there and back may miss where it began; what it misses by more is covered or uncovered."""
_SMALL_PIXELS = 10_000
"""Of pictures whose flow is refined up to their own size unless it is smooth; that of others up to half of it."""


def flow_and_back(
    before: NDArray[np.floating], after: NDArray[np.floating], *, smooth: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pixels (H, W, 2) right and down that things move from one grey picture (H, W), 0 to 1, to the other, and back.

    ``smooth``: also where nothing is to be seen, in twice the time.
    """
    first, second = (np.rint(255 * np.clip(each, 0, 1)).astype(np.uint8) for each in (before, after))
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    if not smooth:
        method.setVariationalRefinementIterations(0)
        method.setFinestScale(0 if first.size < _SMALL_PIXELS else 1)
    none = np.zeros((*first.shape, 2), np.float32)
    return floats(method.calc(first, second, none)), floats(method.calc(second, first, none.copy()))
