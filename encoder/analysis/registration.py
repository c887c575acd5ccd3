"""Motion of a camera's whole picture against its first frame: the shake of a static camera.

Lucas-Kanade tracks corners of the first picture in every other, on locally normalised brightness, which removes changes
of light. A robust fit gives one small similarity per frame. A shaking camera moves all corners: if three of ten stay,
the camera has not moved. If half of the corners deviate from the similarity by more than half of it, objects move, and
the camera's motion is undetermined.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

SHAKE_LIMIT = 0.1
"""Least displacement that counts, in pixels of the analysed size: ten times that of a static picture with noise. It
changes an edge of 100 levels, two pixels wide, by 5 levels."""

_MOST_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE = 1000, 0.02, 7
_PARTS, _CORNERS_PER_PART = (5, 4), 10
_FEWEST = 12
_WINDOW, _LEVELS = (15, 15), 2
_STILL_SHARE = 0.3
_ALIKE = 0.5
_ROUNDS = 8
_SMALLEST_SPREAD = 0.02
"""Least spread of displacements, in pixels: that of noise."""


@dataclass(frozen=True)
class CameraPath:
    """One camera's motion: ``displacement`` (F,) root mean square over the picture, pixels; NaN where it is
    undetermined.

    ``transforms`` (F, 2, 3): a pixel of the first picture to that of frame f, centre of the first pixel at (0, 0).
    """

    displacement: F64
    transforms: F64

    @property
    def shakes(self) -> bool:
        """Whether the camera moves more than a fixed one's pictures seem to."""
        return bool(np.nan_to_num(self.displacement).max() >= SHAKE_LIMIT)


def camera_path(pictures: U8) -> CameraPath:
    """Tracks the corners of a camera's first picture through all (F, H, W, 3)."""
    count = len(pictures)
    displacement = np.full(count, np.nan)
    transforms = np.tile(np.eye(2, 3), (count, 1, 1))
    first = _normalised(pictures[0])
    corners = _corners(first)
    if len(corners) < _FEWEST:
        return CameraPath(displacement, transforms)
    displacement[0] = 0.0
    centre = np.array([(pictures.shape[2] - 1) / 2, (pictures.shape[1] - 1) / 2])
    for index in range(1, count):
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            first, _normalised(pictures[index]), corners, None, winSize=_WINDOW, maxLevel=_LEVELS
        )  # type: ignore[call-overload]
        kept = status.ravel() == 1
        if kept.sum() >= _FEWEST:
            at = corners[kept, 0].astype(np.float64) - centre
            transforms[index], displacement[index] = _similarity(at, (found - corners)[kept, 0].astype(np.float64))
            transforms[index, :, 2] += centre - transforms[index, :, :2] @ centre
    return CameraPath(displacement, transforms)


def _corners(picture: U8) -> F32:
    """The strongest corners (N, 1, 2) of every part of the picture, so that no single texture dominates."""
    found = cv2.goodFeaturesToTrack(picture, _MOST_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE)
    if found is None:
        return np.empty((0, 1, 2), np.float32)
    height, width = picture.shape
    columns, rows = _PARTS
    part = (found[:, 0, 0] * columns // width) + columns * (found[:, 0, 1] * rows // height)
    kept = [np.flatnonzero(part == each)[:_CORNERS_PER_PART] for each in range(columns * rows)]
    return np.asarray(found[np.sort(np.concatenate(kept))], np.float32)


def _normalised(picture: U8) -> U8:
    """Luminance with local mean and contrast taken out, around 128."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    centred = grey - cv2.blur(grey, (13, 13))
    contrast = cv2.sqrt(cv2.blur(centred * centred, (13, 13)) + 9)
    return np.asarray(np.clip(centred / contrast * 40 + 128, 0, 255), np.uint8)


def _similarity(at: F64, moved: F64) -> tuple[F64, float]:
    """The similarity (2, 3) that most displacements (N, 2) agree with, and its size in pixels over these places."""
    rows = np.zeros((len(at), 2, 4))
    rows[:, 0, 0] = rows[:, 1, 1] = 1
    rows[:, 0, 2], rows[:, 1, 2] = -at[:, 1], at[:, 0]
    rows[:, :, 3] = at
    scale = float(np.abs(at).max()) or 1.0
    rows[:, :, 2:] /= scale
    x = np.array([*np.median(moved, axis=0), 0.0, 0.0])
    for _ in range(_ROUNDS):
        missed = np.linalg.norm(moved - rows @ x, axis=1)
        spread = max(1.5 * float(np.median(missed)), _SMALLEST_SPREAD)
        weight = np.maximum(0.0, 1 - (missed / (4 * spread)) ** 2)
        weighted = rows * weight[:, None, None]
        normal = np.einsum("nij,nik->jk", weighted, rows) + 1e-6 * np.eye(4)
        x = np.linalg.solve(normal, np.einsum("nij,ni->j", weighted, moved))
    moves = rows @ x
    size = float(np.sqrt((moves**2).sum(axis=1).mean()))
    still = float(np.quantile(np.linalg.norm(moved, axis=1), _STILL_SHARE))
    alike = np.median(np.linalg.norm(moved - moves, axis=1)) <= max(_ALIKE * size, SHAKE_LIMIT)
    turn, grow = x[2:] / scale
    return np.array([[1 + grow, -turn, x[0]], [turn, 1 + grow, x[1]]]), min(size, still) if alike else np.nan
