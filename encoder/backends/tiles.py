"""The tiles in which pictures are drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_TILE_PIXELS = 16


def tiles_with(marks: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """One byte per tile, in rows: whether it has one of the ``marks`` (H, W)."""
    across, down = (np.arange(0, size, _TILE_PIXELS) for size in marks.shape[::-1])
    found = np.logical_or.reduceat(np.logical_or.reduceat(marks, down, axis=0), across, axis=1)
    return np.ascontiguousarray(found, np.uint8).ravel()
