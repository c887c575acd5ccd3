"""Where a run is wrong: a small map for each held-out camera of how far its pixels are from what it recorded.

Kept: the root of the mean square error over frames and channels, in 8-bit levels, as half floats; a run's maps take
some 30 kB a camera. Pixels are put together by the mean of their squares, so that a map's mean square is the picture's.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

MOST_COLUMNS = 160
"""Of a map."""


def packed(errors: Sequence[NDArray[np.float64]]) -> bytes:
    """A file of maps of mean square errors, (H, W) each, of pictures in 0..1."""
    data = io.BytesIO()
    np.savez_compressed(data, *map(_small, errors))
    return data.getvalue()


def unpacked(path: Path) -> list[NDArray[np.float32]]:
    """The maps of such a file, in their order, in 8-bit levels. Raises what `numpy.load` does."""
    with np.load(io.BytesIO(path.read_bytes())) as kept:
        return [np.asarray(kept[name], np.float32) for name in kept.files]


def _small(errors: NDArray[np.float64]) -> NDArray[np.float16]:
    height, width = errors.shape
    if width > MOST_COLUMNS:
        size = (MOST_COLUMNS, max(1, round(height * MOST_COLUMNS / width)))
        errors = np.asarray(cv2.resize(errors, size, interpolation=cv2.INTER_AREA), np.float64)
    return (255 * np.sqrt(errors)).astype(np.float16)
