"""Numerical tools that several rooms use: bilinear lookup, robust weights, nearest neighbours."""

from __future__ import annotations

from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

P = TypeVar("P", bound="np.integer[Any] | np.floating[Any]")
F = TypeVar("F", np.float32, np.float64)

_LOOKUP_WIDTH = 1024
"""Positions are looked up in rows of so many: ``cv2.remap`` takes at most 32 767 rows and columns."""


def floats(values: NDArray[np.generic]) -> NDArray[np.float32]:
    """Values as float32, without a copy if they are: OpenCV's stubs do not say what a function returns."""
    return np.asarray(values, np.float32)


def bilinear(picture: NDArray[P], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[P]:
    """Values (P, C) of a picture (H, W, C) at positions (P,), corner of the picture at 0; its borders go on outside."""
    rows = -(-len(u) // _LOOKUP_WIDTH)
    at = np.zeros((2, rows * _LOOKUP_WIDTH), np.float32)
    at[0, : len(u)], at[1, : len(u)] = u - 0.5, v - 0.5
    if not rows:
        return np.zeros((0, picture.shape[2]), picture.dtype)
    columns, lines = at.reshape(2, rows, _LOOKUP_WIDTH)
    values = cv2.remap(picture, columns, lines, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(values.reshape(-1, picture.shape[2])[: len(u)], picture.dtype)


def tukey(residuals: NDArray[F], reach: float) -> NDArray[F]:
    """Tukey's biweight: 1 at a residual of 0, 0 from ``reach`` on."""
    return np.asarray(np.square(np.maximum(1 - np.square(residuals / residuals.dtype.type(reach)), 0)))


def nearest(
    points: NDArray[np.float32], count: int, places: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Rows (P, count) of the ``count`` points (N, 3) nearest to each of ``places`` (P, 3), by default the points
    themselves, nearest first, and their squared distances."""
    tree = cv2.flann.Index(points, {"algorithm": 4, "leaf_max_size": 10})  # a single k-d tree, exact
    rows, squared = tree.knnSearch(points if places is None else places, count, params={"checks": -1})
    return np.asarray(rows, np.int32), np.asarray(squared, np.float32)
