"""What structure from motion goes by: SIFT features of each camera, and matches of pairs of cameras.

A camera that stands still has one set of features: those of its median picture over the take, which has neither noise
nor what moves, and, each for itself, those of what moves in single instants. These match within their instant only, and
are right only where the cameras run in step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..matching import mutual_matches
from .footage import U8

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

STATIC = -1
"""In place of an instant: features of the median picture."""

_MAX_SIDE = 1600
"""Pixels to which larger pictures are reduced: SIFT's places are no more exact in larger ones, and its time grows."""
_MAX_FEATURES = 4096
"""Of one picture; the matching of a pair takes their square."""
_PEAK = 0.003
"""Least contrast of a feature, of SIFT's difference of Gaussians: half of COLMAP's. A median picture has less noise."""
_MOVES_STEPS, _MOVES_DEVIATIONS = 6.0, 3.0
"""Least difference from the median picture of what moves: 8-bit steps, and the take's median difference."""
_WINDOW = 5
"""Pixels over which differences are averaged."""
_MARGIN = 9
"""Pixels around what moves that move, too: about the window that describes a feature of the smallest scale."""
_SHIFTS_WIDTH, _SHIFTS_RESPONSE = 640, 0.4
"""Of pictures that are held against each other, and the response of phase correlation from which it is believed: a
camera of `workbench` that is knocked has .6, one of `workbench_drift`, which shakes, .8; false shifts on seven
recordings have up to .37."""
_MAX_DISTANCE = 0.7
"""Largest distance of descriptors of length 1, as COLMAP has it."""


@dataclass(frozen=True)
class Features:
    """Of one camera: pixels (N, 2) from the picture's corner, descriptors (N, 128) of length 1, instants (N,).

    ``moving``: the share of the picture that moves. ``shifted``: pixels, of a picture 640 wide, by which all of it is
    elsewhere than in the first instant, at most; 0 where nothing says so.
    """

    pixels: F64
    descriptors: NDArray[np.float32]
    instants: I64
    moving: float = 0.0
    shifted: float = 0.0

    def static(self) -> Features:
        """Only those of the median picture."""
        return self._where(self.instants == STATIC)

    def _where(self, chosen: NDArray[np.bool_]) -> Features:
        return Features(self.pixels[chosen], self.descriptors[chosen], self.instants[chosen])


def features_of(pictures: Sequence[U8], extractor: Any) -> Features:
    """Features of one camera's pictures (H, W, 3) of several instants, by pycolmap's ``extractor``."""
    height, width = pictures[0].shape[:2]
    scale = min(1.0, _MAX_SIDE / max(height, width))
    size = (round(width * scale), round(height * scale))
    grey = np.asarray(
        [cv2.resize(_grey(picture), size, interpolation=cv2.INTER_AREA) for picture in pictures], np.uint8
    )
    median = np.median(grey, axis=0).astype(np.uint8)
    moving = _moving(grey, median)
    features = [_sift(median, moving.mean(axis=0) <= 0.5, extractor)]
    features += [_sift(picture, mask, extractor) for picture, mask in zip(grey, moving, strict=True) if mask.any()]
    instants = [STATIC, *np.flatnonzero(moving.any(axis=(1, 2))).tolist()]
    return Features(
        np.concatenate([pixels for pixels, _ in features]) * [width / size[0], height / size[1]],
        np.concatenate([descriptors for _, descriptors in features]),
        np.repeat(instants, [len(pixels) for pixels, _ in features]),
        float(moving.mean()),
        _shifted(grey),
    )


def _grey(picture: U8) -> U8:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)


def _moving(grey: U8, median: U8) -> NDArray[np.bool_]:
    """Where pictures (T, H, W) differ from their median picture (H, W)."""
    differences = np.abs(grey.astype(np.int16) - median).astype(np.uint8)
    limit = max(_MOVES_STEPS, _MOVES_DEVIATIONS * float(np.median(differences)))
    margin = np.ones((_MARGIN, _MARGIN), np.uint8)
    smooth = (cv2.blur(picture.astype(np.float32), (_WINDOW, _WINDOW)) for picture in differences)
    return np.stack([cv2.dilate((picture > limit).astype(np.uint8), margin) > 0 for picture in smooth])


def _shifted(grey: U8) -> float:
    """By how many pixels, of a picture 640 wide, pictures (T, H, W) are shifted against the first, at most.

    By phase correlation (`cv2.phaseCorrelate`), which finds no shift where only part of a picture moves.
    """
    height, width = grey.shape[1:]
    size = (_SHIFTS_WIDTH, max(round(height * _SHIFTS_WIDTH / width), 1))
    small = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32) for picture in grey]
    window = cv2.createHanningWindow(size, cv2.CV_32F)
    shifts = [cv2.phaseCorrelate(small[0], picture, window) for picture in small[1:]]
    return max((math.hypot(*shift) for shift, response in shifts if response > _SHIFTS_RESPONSE), default=0.0)


def _sift(grey: U8, mask: NDArray[np.bool_], extractor: Any) -> tuple[F64, NDArray[np.float32]]:
    """Pixels and descriptors of the features where ``mask`` (H, W) is true."""
    import pycolmap

    keypoints, described = extractor.extract(pycolmap.Bitmap.from_array(grey))
    pixels = np.asarray(pycolmap.keypoints_to_matrix(keypoints)[:, :2], np.float64)
    columns, rows = np.minimum(pixels.astype(int), [grey.shape[1] - 1, grey.shape[0] - 1]).T
    within = mask[rows, columns]
    descriptors = np.asarray(described.data, np.float32)[within]
    lengths = np.maximum(np.linalg.norm(descriptors, axis=1, keepdims=True), 1e-9)
    return pixels[within], descriptors / lengths


def sift_extractor() -> Any:
    """pycolmap's SIFT, on one thread of the CPU."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.num_threads, options.use_gpu = 1, False
    options.sift.max_num_features, options.sift.peak_threshold = _MAX_FEATURES, _PEAK
    return pycolmap.FeatureExtractor.create(options)


def matched(first: Features, second: Features) -> I64:
    """Rows (M, 2) of two cameras' features that match: each other's best, clearly, of one instant."""
    parts = [np.zeros((0, 2), np.int64)]
    for instant in np.intersect1d(first.instants, second.instants):
        rows, columns = np.flatnonzero(first.instants == instant), np.flatnonzero(second.instants == instant)
        one, other = mutual_matches(first.descriptors[rows], second.descriptors[columns], max_distance=_MAX_DISTANCE)
        parts.append(np.stack([rows[one], columns[other]], axis=1))
    return np.concatenate(parts)
