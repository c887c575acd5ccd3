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

SHAKE_LIMIT_PIXELS = 0.1
"""Least displacement that counts, in pixels of the analysed size: ten times that of a static picture with noise. It
changes an edge of 100 levels, two pixels wide, by 5 levels."""

_MAX_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PIXELS = 1000, 0.02, 7
_PICTURE_PARTS, _CORNERS_PER_PART = (5, 4), 10
_MIN_CORNERS = 12
_TRACKED_WINDOW_PIXELS, _HALVINGS_TRIED = (15, 15), (1, 2)
"""Halvings of the picture in the search; more where fewer leave it undetermined, and at once after a frame that needed
more."""
_SEARCH_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
"""Steps of a corner's search, and the step in pixels that ends it: a third of what counts, for a single corner."""
_STILL_FRACTION = 0.3
_MAX_DEVIATION_SHARE = 0.5
_SIMILARITY_ROUNDS = 8
_COMPLEX = np.array([1, 1j])
_MIN_SPREAD_PIXELS = 0.02
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
        return bool(np.nan_to_num(self.displacement).max() >= SHAKE_LIMIT_PIXELS)


def camera_path(pictures: U8) -> CameraPath:
    """Tracks the corners of a camera's first picture through all (F, H, W, 3)."""
    count = len(pictures)
    displacement = np.full(count, np.nan)
    transforms = np.tile(np.eye(2, 3), (count, 1, 1))
    first = _normalise(pictures[0])
    corners = _corners(first)
    if len(corners) < _MIN_CORNERS:
        return CameraPath(displacement, transforms)
    displacement[0] = 0.0
    for index in range(1, count):
        now = _normalise(pictures[index])
        for levels in _HALVINGS_TRIED if np.isfinite(displacement[index - 1]) else _HALVINGS_TRIED[1:]:
            transforms[index], displacement[index] = _track(first, now, corners, levels)
            if np.isfinite(displacement[index]):
                break
        if displacement[index] >= SHAKE_LIMIT_PIXELS:
            now = _normalise(under_rows_light_of(pictures[0], pictures[index]))
            striped = _track(first, now, corners, levels)
            if striped[1] < SHAKE_LIMIT_PIXELS:
                transforms[index], displacement[index] = striped
    return CameraPath(displacement, transforms)


def under_rows_light_of(first: U8, now: U8) -> U8:
    """A picture (H, W, 3), with each row as light as most of its pixels were in the first.

    A lamp's stripes over a rolling shutter move, and corners with them.
    """
    were, are = (each.astype(np.float32) + 1 for each in (first, now))
    ratio = np.median(were / are, axis=(1, 2), keepdims=True)
    return np.asarray(np.clip(are * ratio - 1, 0, 255), np.uint8)


def find_again(first: U8, now: U8) -> tuple[F64, F64]:
    """Corners of a picture (H, W, 3), pixels (N, 2), and where they are in another of the same camera."""
    shown = _normalise(first)
    corners = _corners(shown)
    if not len(corners):
        return np.empty((0, 2)), np.empty((0, 2))
    tracked, status, _ = cv2.calcOpticalFlowPyrLK(
        shown, _normalise(now), corners, None, winSize=_TRACKED_WINDOW_PIXELS, maxLevel=3, criteria=_SEARCH_CRITERIA
    )  # type: ignore[call-overload]
    kept = status.ravel() == 1
    before, after = (each[kept, 0].astype(np.float64) + 0.5 for each in (corners, tracked))
    return before, after


def _track(first: U8, now: U8, corners: F32, levels: int) -> tuple[F64, float]:
    """The similarity (2, 3) from the first picture to another, and its displacement."""
    tracked, status, _ = cv2.calcOpticalFlowPyrLK(
        first, now, corners, None, winSize=_TRACKED_WINDOW_PIXELS, maxLevel=levels, criteria=_SEARCH_CRITERIA
    )  # type: ignore[call-overload]
    kept = status.ravel() == 1
    if kept.sum() < _MIN_CORNERS:
        return np.eye(2, 3), np.nan
    centre = np.array([(first.shape[1] - 1) / 2, (first.shape[0] - 1) / 2])
    at = corners[kept, 0].astype(np.float64) - centre
    transform, displacement = _similarity(at, (tracked - corners)[kept, 0].astype(np.float64))
    transform[:, 2] += centre - transform[:, :2] @ centre
    return transform, displacement


def _corners(picture: U8) -> F32:
    """The strongest corners (N, 1, 2) of every part of the picture, so that no single texture dominates."""
    corners = cv2.goodFeaturesToTrack(picture, _MAX_CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PIXELS)
    if corners is None:
        return np.empty((0, 1, 2), np.float32)
    height, width = picture.shape
    columns, rows = _PICTURE_PARTS
    part = (corners[:, 0, 0] * columns // width) + columns * (corners[:, 0, 1] * rows // height)
    kept = [np.flatnonzero(part == each)[:_CORNERS_PER_PART] for each in range(columns * rows)]
    return np.asarray(corners[np.sort(np.concatenate(kept))], np.float32)


def _normalise(picture: U8) -> U8:
    """Luminance with local mean and contrast taken out, around 128."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    centred = grey - cv2.boxFilter(grey, cv2.CV_32F, (13, 13))
    contrast = cv2.sqrt(cv2.blur(centred * centred, (13, 13)) + 9)
    return np.asarray(np.clip(centred / contrast * 40 + 128, 0, 255), np.uint8)


def _similarity(at: F64, moved: F64) -> tuple[F64, float]:
    """The similarity (2, 3) that most displacements (N, 2) agree with, and its size in pixels over these places.

    Places and displacements are complex numbers, so that turning and growing are one factor.
    """
    positions, moves = at @ _COMPLEX, moved @ _COMPLEX
    shift = complex(np.median(moved[:, 0]), np.median(moved[:, 1]))
    fitted = np.full(len(at), shift)
    factor = 0j
    for _ in range(_SIMILARITY_ROUNDS):
        missed = np.abs(moves - fitted)
        spread = max(1.5 * float(np.median(missed)), _MIN_SPREAD_PIXELS)
        weight = np.maximum(0.0, 1 - (missed / (4 * spread)) ** 2)
        whole = weight.sum()
        middle, mean = (weight @ positions) / whole, (weight @ moves) / whole
        around = positions - middle
        weighted = weight * around.conj()
        factor = (weighted @ (moves - mean)) / max((weighted @ around).real, 1e-6)
        shift = mean - factor * middle
        fitted = shift + factor * positions
    size = float(np.sqrt((np.abs(fitted) ** 2).mean()))
    still = float(np.quantile(np.abs(moves), _STILL_FRACTION))
    alike = np.median(np.abs(moves - fitted)) <= max(_MAX_DEVIATION_SHARE * size, SHAKE_LIMIT_PIXELS)
    grow, turn = factor.real, factor.imag
    transform = np.array([[1 + grow, -turn, shift.real], [turn, 1 + grow, shift.imag]])
    return transform, min(size, still) if alike else np.nan
