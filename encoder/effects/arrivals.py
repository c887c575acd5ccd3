"""What is there in the last picture and was not in the first, or the other way round, and did not just move.

An object has an outline. Where first and last picture differ, the one that shows the object has stronger edges along
the border of the difference: the object *arrived* there or it *left* there. What merely moved left one place and
arrived at another, and restructured pixels join the two: its swept area. So a swept area with arrivals and departures
that balance is motion; one with arrivals alone is an emergence, one with departures alone a disappearance. Nothing is
said of a swept area in which a difference has no clear side, or a place was already (for an arrival) or is still (for
a departure) in motion; nor of one that only left, from a place already in motion. The edge test is that of video
surveillance for bags that were left behind or taken away.

First and last picture only: what comes and goes in between is motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.encoder.masks import BoolArray

from .changes import WINDOW_PIXELS, ChangeMaps, change_maps

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

_OBJECT_LEVELS = 12
"""Difference of an object from what it covers, in levels; soft shadows differ by less."""
_CLEAR_SIDE = 0.15
"""Share of the border along which the one picture must have more of the stronger edges than the other."""
_STRONGER = 1.5
_EDGE = 40.0
"""Scharr response that is an edge: a step of 2 to 3 levels after smoothing."""
_OUTLINED = 0.3
"""Share of a difference's border that must be restructured: light has soft borders that are not."""
_RESTING = 0.3
"""Share of a place that may change in the first (or last) two steps and still count as resting."""
_SETTLED = 0.9
_SQUARE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Arrivals:
    """How far arrivals and departures of a camera's swept areas are from balance, per frame (F,), in per cent.

    100 is an object that only arrived (or only left), 0 none, or one that moved. NaN for the first frame and where
    nothing could be told.
    """

    arrived: F64
    left: F64


@dataclass(frozen=True)
class _Difference:
    """A connected difference of last and first picture: its pixels, and its side: arrived 1, left -1, unclear 0."""

    place: BoolArray
    side: int
    busy_at_first: bool


def untold(frames: int) -> Arrivals:
    return Arrivals(np.full(frames, np.nan), np.full(frames, np.nan))


def camera_arrivals(pictures: U8, maps: Sequence[ChangeMaps], noise: float) -> Arrivals:
    """What arrived and what left over a camera's pictures (F, H, W, 3); ``maps``: of each against the one before."""
    arrived, left = (np.zeros(len(pictures)) for _ in range(2))
    arrived[0] = left[0] = np.nan
    found = Arrivals(arrived, left)
    unclear = False
    restructured = np.array([each.restructured for each in maps])
    if not restructured.any():
        return found
    swept = cv2.dilate(np.any(restructured, axis=0).view(np.uint8), _SQUARE)
    areas, labels = cv2.connectedComponents(swept, connectivity=8)
    differences = _differences(pictures[0], pictures[-1], maps, noise)
    for area in range(1, areas):
        path = labels == area
        inside = [each for each in differences if (each.place & path).sum() >= WINDOW_PIXELS]
        if not inside:
            continue
        if any(each.side == 0 for each in inside):
            unclear = True
            continue
        moving = np.flatnonzero((restructured & path).any(axis=(1, 2))) + 1
        came, went = (np.any([d.place for d in inside if d.side == side] or [~path], axis=0) & path for side in (1, -1))
        balance = (int(came.sum()) - int(went.sum())) / (int(came.sum()) + int(went.sum()))
        if balance > 0:
            last = _settled(pictures, came)
            _raise(arrived, slice(moving[0], last + 1), balance)
        elif any(each.busy_at_first for each in inside):
            unclear = True
        else:
            _raise(left, slice(moving[0], moving[-1] + 1), -balance)
    return untold(len(pictures)) if unclear and not np.nansum(arrived + left) else found


def _raise(values: F64, frames: slice, balance: float) -> None:
    values[frames] = np.maximum(values[frames], 100 * balance)


def _differences(first: U8, last: U8, maps: Sequence[ChangeMaps], noise: float) -> list[_Difference]:
    whole = change_maps(first, last, noise)
    objects = (cv2.absdiff(cv2.blur(last, (3, 3)), cv2.blur(first, (3, 3))).max(axis=2) > _OBJECT_LEVELS) & whole.near()
    closed = cv2.morphologyEx(objects.view(np.uint8), cv2.MORPH_CLOSE, _SQUARE)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    edges = _edges(first), _edges(last)
    early, late = (np.any([each.near() for each in some], axis=0) for some in (maps[:2], maps[-2:]))
    found = []
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] < WINDOW_PIXELS:
            continue
        place = labels == label
        shape = place.view(np.uint8)
        border = cv2.dilate(shape, _SQUARE) != cv2.erode(shape, _SQUARE)
        outlined = whole.restructured[border].mean() >= _OUTLINED
        side = _side(edges[0][border], edges[1][border]) if outlined else 0
        busy_at_first, busy_at_last = (bool(moves[place].mean() >= _RESTING) for moves in (early, late))
        if (side > 0 and busy_at_first) or (side < 0 and busy_at_last):
            side = 0
        found.append(_Difference(place, side, busy_at_first))
    return found


def _side(first: F32, last: F32) -> int:
    """Which picture has the object, by its edges along the border: 1 the last, -1 the first, 0 not clear."""
    strong = np.maximum(first, last) > _EDGE
    lead = float((strong & (last > _STRONGER * first)).mean() - (strong & (first > _STRONGER * last)).mean())
    return 0 if abs(lead) < _CLEAR_SIDE else 1 if lead > 0 else -1


def _edges(picture: U8) -> F32:
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    across, down = cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1)
    return np.asarray(cv2.sqrt(across * across + down * down).max(axis=2))


def _settled(pictures: U8, place: BoolArray) -> int:
    """The first frame by which nine tenths of what differs in the end have begun to differ from the first picture."""
    here = pictures[:, place].astype(np.int16)
    differs = np.abs(here - here[0]).max(axis=2) > _OBJECT_LEVELS
    begun = np.logical_or.accumulate(differs[:, differs[-1]], axis=0).sum(axis=1)
    return int(np.argmax(begun >= _SETTLED * begun[-1]))
