"""Whether all cameras record the same moments: what moves must match the neighbours' pictures of the same frame.

Features on moving things are matched between neighbours, one of them a frame earlier, in the same frame, and a frame
later. A camera is late where most of its neighbours agree with its next frame better than with its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera

from ..change.masks import dilate
from .changes import change_maps
from .matches import Features, features_of, matched, neighbouring

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

LAGS = (-1, 0, 1)
_COMPARED_FRAMES = 2
"""Frames that are compared: those in which most moves."""
_MAX_LINE_PIXELS = 1.5
"""Distance from the epipolar line, in pixels, from which a match is no evidence."""
_MIN_AGREEMENT_RATIO = 1.25
"""Agreement of a lag over that of the same frame from which the lag counts."""
_MIN_LINE_MATCHES = 15.0
"""Matches on the line that a decision needs."""
_MIN_LEAD_DEVIATIONS = 3.0
"""Matches on the line that a lag has more than the same frame, in deviations of their number, to count."""


def delays(
    cameras: Sequence[Camera],
    pictures: Sequence[U8],
    steady: Sequence[bool],
    noise: Sequence[float],
    each: Callable[..., Iterator[Any]],
) -> F64:
    """By how many frames (cameras,) each one is late, -1, 0 or 1; NaN where too little moves.

    ``pictures``: of successive frames, (F, H, W, 3) each. ``steady``: whether a camera stands still, so that it shows
    when most moves; ``noise``: levels.
    """
    moving = np.array(list(each(_moving, pictures, steady, noise)))
    agreement = np.zeros((len(cameras), len(LAGS)))
    ballots = np.zeros((len(cameras), len(LAGS)))
    pairs = neighbouring(cameras)
    for moment in _moments(moving):
        seen = list(each(partial(_around, moment), cameras, pictures, noise))
        for one, two in pairs:
            found = _agreement(cameras, one, two, seen[one], seen[two])
            for camera, lags in ((two, found), (one, found[::-1])):
                agreement[camera] += lags
                ballots[camera, int(np.argmax(lags))] += float(lags.max() >= _MIN_AGREEMENT_RATIO * lags[LAGS.index(0)])
    return np.array([_delay(lags, votes) for lags, votes in zip(agreement, ballots, strict=True)])


def _delay(agreement: F64, ballots: F64) -> float:
    best = int(np.argmax(agreement))
    if agreement[best] < _MIN_LINE_MATCHES:
        return np.nan
    same = agreement[LAGS.index(0)]
    more = max(_MIN_AGREEMENT_RATIO * same, same + _MIN_LEAD_DEVIATIONS * math.sqrt(same + agreement[best]))
    clear = agreement[best] >= more and ballots[best] * 2 > ballots.sum()
    return float(LAGS[best]) if clear else 0.0


def _moving(pictures: U8, steady: bool, noise: float) -> F64:
    """The share of a camera's picture that moves, of every frame (F,) against the one before."""
    moving = np.zeros(len(pictures))
    if steady:
        moving[1:] = [change_maps(*pair, noise).restructured.mean() for pair in pairwise(pictures)]
    return moving


def _moments(moving: F64) -> list[int]:
    """The frames, none the first or last, in which most moves over all cameras; ``moving`` (cameras, F)."""
    most = moving[:, 1:-1].mean(axis=0)
    found = np.argsort(-most, kind="stable")[:_COMPARED_FRAMES]
    return [int(frame) + 1 for frame in found if most[frame] > 0]


def _around(moment: int, camera: Camera, pictures: U8, noise: float) -> list[Features]:
    """Features of what moves, in the frame before a moment, in its own, and in the next."""
    before, now, after = pictures[moment - 1 : moment + 2]
    moves = change_maps(before, now, noise).restructured | change_maps(now, after, noise).restructured
    mask = np.asarray(dilate(moves, 2), np.uint8)
    return [features_of(camera, picture, mask) for picture in (before, now, after)]


def _agreement(cameras: Sequence[Camera], one: int, two: int, here: list[Features], there: list[Features]) -> F64:
    """How well (lags,) the first camera's moment fits the second's frame before, its own, and its next."""
    found = []
    for lag in range(len(LAGS)):
        pair = matched(one, two, here[LAGS.index(0)], there[lag])
        distances = np.abs(pair.epipolar_distances(cameras))
        found.append(float(np.maximum(1 - distances / _MAX_LINE_PIXELS, 0).sum()))
    return np.array(found)
