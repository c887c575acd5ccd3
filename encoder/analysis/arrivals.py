"""Arrivals and departures of objects, as opposed to motion.

An object has an outline. Along the border of a difference between the pictures before and after a change, the picture
with the object has stronger edges: the object *arrived* there or it *left*. A moving object left one place and arrived
at another, and restructured pixels connect the two in space and time: its *path*. A path with balanced arrivals and
departures is motion, one with arrivals alone an emergence, one with departures alone a disappearance. The pictures
before the first and after the last step of a path decide about it, independently of other motion. Video surveillance
applies this edge test to abandoned or stolen bags.

A path stays undetermined if a difference has no clear side; if the place of an arrival was already in motion at the
clip's begin, or that of a departure still is at its end; if it only leaves, from a place already in motion; and if it
still arrives at the clip's end.

An object that comes and goes within the clip is motion. An object that touches a moving one in the picture shares its
path; other cameras see the two apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..change.masks import BoolArray
from .changes import NEAR_FRACTION, WINDOW_PIXELS, ChangeMaps, change_maps, largest_channel

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
IntArray = NDArray[np.int64]

_OBJECT_LEVELS = 12
"""Least difference of an object from its background, in levels; soft shadows differ by less."""
_CLEAR_SIDE = 0.15
"""Least lead of one picture in the share of the border with stronger edges."""
_STRONGER = 1.5
_EDGE = 40.0
"""Least Scharr response of an edge: a step of 2 to 3 levels after smoothing."""
_OUTLINED = 0.3
"""Least restructured share of a difference's border: light has soft borders, which are not restructured."""
_RESTING = 0.3
"""Largest share of a resting place that changes in the first (or last) two steps."""
_SETTLED = 0.9
_SQUARE = np.ones((3, 3), np.uint8)


@dataclass(frozen=True)
class Arrivals:
    """Imbalance of arrivals and departures in a camera's swept areas, per frame (F,), in per cent.

    100: an object that only arrived (or only left); 0: no object, or a moving one. NaN: the first frame, and
    undetermined ones.
    """

    arrived: F64
    left: F64


@dataclass(frozen=True)
class _Path:
    """Restructured pixels connected over time: ``swept`` (H, W), and its ``first`` and ``last`` step.

    Step t leads from picture t to picture t + 1.
    """

    swept: BoolArray
    first: int
    last: int


@dataclass(frozen=True)
class _Difference:
    """A connected difference of two pictures: its pixels, and its side: arrived 1, left -1, unclear 0."""

    place: BoolArray
    side: int
    busy_at_first: bool


def undetermined(frames: int) -> Arrivals:
    """The arrivals of a camera that cannot be judged: NaN for each of its ``frames``."""
    return Arrivals(np.full(frames, np.nan), np.full(frames, np.nan))


def camera_arrivals(pictures: U8, maps: Sequence[ChangeMaps], noise: float) -> Arrivals:
    """Arrivals and departures in a camera's pictures (F, H, W, 3); ``maps``: of each against the one before."""
    arrived, left = (np.zeros(len(pictures)) for _ in range(2))
    arrived[0] = left[0] = np.nan
    unclear = False
    for path in _paths(maps) if len(maps) else []:
        before, after = path.first, path.last + 1
        inside = _differences(pictures, maps, path, noise)
        if any(each.side == 0 for each in inside):
            unclear = True
            continue
        came, went = (sum(int(d.place.sum()) for d in inside if d.side == side) for side in (1, -1))
        if not came + went:
            continue
        balance = (came - went) / (came + went)
        if balance > 0:
            place = np.any([d.place for d in inside if d.side == 1], axis=0)
            settled = before + _settled(pictures[before : after + 1], place)
            if settled == len(pictures) - 1:
                unclear = True  # still on its way as the clip ends
            else:
                _raise(arrived, slice(before + 1, settled + 1), balance)
        elif any(each.busy_at_first for each in inside):
            unclear = True
        else:
            _raise(left, slice(before + 1, after + 1), -balance)
    return undetermined(len(pictures)) if unclear and not np.nansum(arrived + left) else Arrivals(arrived, left)


def _paths(maps: Sequence[ChangeMaps]) -> list[_Path]:
    """The sufficiently large paths, in the order of their first steps."""
    shape = maps[0].restructured.shape
    parents = [0]  # union-find over the areas of all steps: the path of each; 0: none
    pixels, numbers, steps = ([np.zeros(0, np.int64)] for _ in range(3))
    before, now = (np.zeros(shape[0] * shape[1], np.int64) for _ in range(2))
    for step, each in enumerate(maps):
        grown = cv2.dilate(each.restructured.view(np.uint8), _SQUARE)
        count, labels = cv2.connectedComponents(grown, connectivity=8)
        here = np.flatnonzero(grown.view(np.bool_))
        old, new = before[here], labels.ravel()[here] + np.int64(len(parents) - 1)
        parents.extend(range(len(parents), len(parents) + count - 1))
        # A pair as one number: sorting pairs takes several times as long.
        both = np.unique((old * len(parents) + new)[old > 0])
        for pair in both.tolist():
            old_root, new_root = (_root(parents, number) for number in divmod(pair, len(parents)))
            parents[new_root] = old_root
        now.fill(0)
        now[here] = new
        before, now = now, before
        pixels.append(here)
        numbers.append(new)
        steps.append(np.full(len(here), step))
    roots = np.array([_root(parents, number) for number in range(len(parents))])
    return _grouped(shape, np.concatenate(pixels), np.concatenate(steps), roots[np.concatenate(numbers)])


def _grouped(shape: tuple[int, ...], pixels: IntArray, steps: IntArray, paths: IntArray) -> list[_Path]:
    """Paths from flat pixels (P,) with their steps, in the steps' order, and path numbers."""
    order = np.argsort(paths, kind="stable")
    starts = np.flatnonzero(np.diff(paths[order]) > 0) + 1
    found = []
    for rows in np.split(order, starts):
        if len(rows) < WINDOW_PIXELS:
            continue
        swept = np.zeros(shape, bool)
        swept.ravel()[pixels[rows]] = True
        if swept.sum() >= WINDOW_PIXELS:
            found.append(_Path(swept, int(steps[rows[0]]), int(steps[rows[-1]])))
    return sorted(found, key=lambda path: path.first)


def _root(parents: list[int], number: int) -> int:
    while parents[number] != number:
        parents[number] = parents[parents[number]]
        number = parents[number]
    return number


def _raise(values: F64, frames: slice, balance: float) -> None:
    values[frames] = np.maximum(values[frames], 100 * balance)


def _differences(pictures: U8, maps: Sequence[ChangeMaps], path: _Path, noise: float) -> list[_Difference]:
    """Pixels at which the pictures before and after a path differ as much as objects do."""
    window = _around(path.swept)
    first, last = pictures[path.first][window], pictures[path.last + 1][window]
    swept, width = path.swept[window], pictures.shape[2]
    whole = change_maps(first, last, noise)
    objects = largest_channel(cv2.absdiff(cv2.blur(last, (3, 3)), cv2.blur(first, (3, 3)))) > _OBJECT_LEVELS
    objects &= whole.near(width)
    closed = cv2.morphologyEx(objects.view(np.uint8), cv2.MORPH_CLOSE, _SQUARE)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    edges = _edges(first), _edges(last)
    # Motion in the clip's first and last two steps may extend beyond the clip.
    ends = maps[path.first : 2], maps[max(len(maps) - 2, 0) : path.last + 1]
    early, late = (_moving(some, window, path.swept.shape) for some in ends)
    found = []
    for label in range(1, count):
        place = (labels == label) & swept
        if stats[label, cv2.CC_STAT_AREA] < WINDOW_PIXELS or place.sum() < WINDOW_PIXELS:
            continue
        shape = (labels == label).view(np.uint8)
        border = cv2.dilate(shape, _SQUARE) != cv2.erode(shape, _SQUARE)
        # What fills the picture has no border in it.
        outlined = bool(border.any()) and whole.restructured[border].mean() >= _OUTLINED
        side = _side(edges[0][border], edges[1][border]) if outlined else 0
        busy_at_first, busy_at_last = (bool(moves[place].mean() >= _RESTING) for moves in (early, late))
        if (side > 0 and busy_at_first) or (side < 0 and busy_at_last):
            side = 0
        everywhere = np.zeros(path.swept.shape, bool)
        everywhere[window] = place
        found.append(_Difference(everywhere, side, busy_at_first))
    return found


def _around(area: BoolArray) -> tuple[slice, slice]:
    """Rows and columns of an area and its surroundings, as far as nearby changes may reach."""
    margin = round(2 * NEAR_FRACTION * area.shape[1]) + math.isqrt(WINDOW_PIXELS)
    spans = [np.flatnonzero(area.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (slice(max(0, int(span[0]) - margin), int(span[-1]) + 1 + margin) for span in spans)
    return rows, columns


def _moving(maps: Sequence[ChangeMaps], window: tuple[slice, slice], shape: tuple[int, ...]) -> BoolArray:
    """Moving pixels in the ``window`` of a picture of this ``shape``, over all of the steps."""
    moves = np.zeros(shape, bool)[window]
    for each in maps:
        moves |= ChangeMaps(each.changed[window], each.restructured[window]).near(shape[1])
    return moves


def _side(first: F32, last: F32) -> int:
    """The picture with the object, by edges along the border: 1 the last, -1 the first, 0 unclear."""
    strong = np.maximum(first, last) > _EDGE
    lead = float((strong & (last > _STRONGER * first)).mean() - (strong & (first > _STRONGER * last)).mean())
    return 0 if abs(lead) < _CLEAR_SIDE else 1 if lead > 0 else -1


def _edges(picture: U8) -> F32:
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32)
    across, down = cv2.Scharr(smooth, cv2.CV_32F, 1, 0), cv2.Scharr(smooth, cv2.CV_32F, 0, 1)
    return largest_channel(np.asarray(cv2.magnitude(across, down), np.float32))


def _settled(pictures: U8, place: BoolArray) -> int:
    """First frame at which nine tenths of the finally differing pixels already differ from the first picture."""
    here = pictures[:, place].astype(np.int16)
    differs = np.abs(here - here[0]).max(axis=2) > _OBJECT_LEVELS
    begun = np.logical_or.accumulate(differs[:, differs[-1]], axis=0).sum(axis=1)
    return int(np.argmax(begun >= _SETTLED * begun[-1]))
