"""Which cameras are not where the calibration has them: turned, elsewhere, or with another camera's pictures.

The share of a camera's matches that lie on the others' epipolar lines says whether it fits; matches of several moments,
where one has too few. A camera of which few fit is turned where a turn puts them onto their lines, and two are swapped
where each one's pictures fit in the other's place. What neither explains is no proof: cameras that stand far apart
share no surface, and their matches are wrong.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera

from .matches import Features, Matches, join_matches, matched, neighbouring
from .reprojection import ON_LINE_PIXELS, Lines, epipolar_residuals, is_turned, turns

F64 = NDArray[np.float64]

_MOMENTS = 3
"""Moments at which matches are sought, where the first has too few."""
_NO_TURN = np.zeros(3)
_SUSPECT_SHARE = 0.7
"""Share of a camera's matches on their lines, over the cameras' median, below which it is suspected."""
_MAX_SUSPECTS = 6
_MIN_MORE_ON_LINES = 15
"""Matches that a turn or an exchange adds on their lines, at least; chance added 11 (`green`) ..."""
_MIN_TIMES_ON_LINES = 1.6
"""... and how many times as many as lay there before."""
_MIN_CONNECTED, _MIN_CONNECTED_SHARE = 8, 0.15
"""Matches on their lines, and their share of all, that connect two cameras: chosen, not measured."""
_MIN_SHARE_RISE = 1.25
"""Least share of its matches on their lines, over that before, of each of two cameras that were exchanged."""
_MISPLACED_PIXELS = 0.5
"""Least distance of a misplaced camera's matches from their epipolar lines, in pixels ..."""
_MISPLACED_RATIO = 4.0
"""... and in multiples of the other cameras' median."""


@dataclass(frozen=True)
class Poses:
    """The cameras' poses against their matches; arrays (cameras,).

    ``residuals``: distance of the nearer matches of the best pair from their lines, pixels. ``turned``: degrees against
    the calibration. Both NaN where matches are too few. ``misplaced``: whether the pose is wrong.
    """

    residuals: F64
    turned: F64
    misplaced: NDArray[np.bool_]


def judge_poses(cameras: Sequence[Camera], matches: Matches) -> Poses:
    """Whether the cameras fit their ``matches``."""
    suspects = suspected(cameras, matches)
    trusted = set(range(len(cameras))) - set(suspects)
    by_lines = {row: _turn_by_lines(cameras, matches, row, trusted - {row}) for row in suspects}
    wrong = {row for row, turn in by_lines.items() if math.isfinite(turn)}
    residuals, turned = epipolar_residuals(cameras, matches), turns(cameras, matches, wrong)
    for row in wrong:
        turned[row] = by_lines[row] if math.isnan(turned[row]) else turned[row]
    finite = residuals[np.isfinite(residuals)]
    usual = float(np.median(finite)) if len(finite) else math.nan
    misplaced = np.array([is_turned(camera, turn) for camera, turn in zip(cameras, turned, strict=True)])
    for row in suspects:
        misplaced[row] |= residuals[row] >= max(_MISPLACED_PIXELS, _MISPLACED_RATIO * usual)
    return Poses(residuals, turned, misplaced)


def suspected(cameras: Sequence[Camera], matches: Matches) -> list[int]:
    """The few cameras of whose matches far fewer than usual lie on their lines, worst first."""
    lines = [Lines.of(cameras, matches, row, set(range(len(cameras)))) for row in range(len(cameras))]
    shares = np.array([each.count_on(_NO_TURN) / len(each) if len(each) else np.nan for each in lines])
    usual = float(np.median(shares[np.isfinite(shares)])) if np.isfinite(shares).any() else 0.0
    few = np.flatnonzero(shares < _SUSPECT_SHARE * usual)
    return sorted(few.tolist(), key=lambda row: float(shares[row]))[:_MAX_SUSPECTS]


def connections(cameras: Sequence[Camera], matches: Matches) -> list[dict[int, int]]:
    """Of each camera the others that it shares surfaces with, and how many of their matches lie on the lines."""
    counts: list[dict[int, int]] = [{} for _ in cameras]
    for pair in matches.pairs:
        distances = np.abs(pair.epipolar_distances(cameras))
        count = int((distances < ON_LINE_PIXELS).sum())
        if count >= max(_MIN_CONNECTED, _MIN_CONNECTED_SHARE * len(distances)):
            counts[pair.first][pair.second] = counts[pair.second][pair.first] = count
    return counts


def find_swaps(
    cameras: Sequence[Camera], features: Sequence[Sequence[Features]], matches: Matches
) -> tuple[list[tuple[int, int]], Matches]:
    """The pairs of cameras whose pictures were exchanged, and the matches of all in their right places.

    ``features``: of each moment those of each camera, from which the ``matches`` were made.
    """
    swaps: list[tuple[int, int]] = []
    for one, two in combinations(sorted(suspected(cameras, matches)), 2):
        if any(row in swap for swap in swaps for row in (one, two)):
            continue
        exchanged = _exchanged(cameras, features, matches, (one, two))
        if _fit_better(cameras, matches, exchanged, (one, two)):
            swaps.append((one, two))
            matches = exchanged
    return swaps, matches


def _exchanged(
    cameras: Sequence[Camera], features: Sequence[Sequence[Features]], matches: Matches, swap: tuple[int, int]
) -> Matches:
    """The matches if the pictures of two cameras are exchanged."""
    pairs = [pair for pair in neighbouring(cameras) if set(pair) & set(swap)]
    exchanged = []
    for seen in features:
        of = dict(enumerate(seen))
        for row, other in (swap, swap[::-1]):
            of[row] = seen[other].through(cameras[row])
        exchanged.append(Matches(tuple(matched(a, b, of[a], of[b]) for a, b in pairs)))
    others = tuple(pair for pair in matches.pairs if not {pair.first, pair.second} & set(swap))
    return Matches(others + join_matches(exchanged).pairs)


def _fit_better(cameras: Sequence[Camera], given: Matches, exchanged: Matches, swap: tuple[int, int]) -> bool:
    """Whether two cameras together fit clearly better with each other's pictures, and neither of them worse."""
    others = set(range(len(cameras))) - set(swap)
    before, after = ([Lines.of(cameras, each, row, others) for row in swap] for each in (given, exchanged))
    were, are = (np.array([lines.count_on(_NO_TURN) for lines in each]) for each in (before, after))
    shares = [count / np.maximum([len(lines) for lines in each], 1) for count, each in ((were, before), (are, after))]
    clear = are.sum() >= max(were.sum() + 2 * _MIN_MORE_ON_LINES, _MIN_TIMES_ON_LINES * were.sum())
    return bool(clear and (shares[1] > _MIN_SHARE_RISE * shares[0]).all())


def _turn_by_lines(cameras: Sequence[Camera], matches: Matches, row: int, others: set[int]) -> float:
    """The turn, in degrees, that puts a camera's matches on their lines; NaN where none does."""
    lines = Lines.of(cameras, matches, row, others)
    turn = lines.turn()
    if turn is None:
        return math.nan
    before, after = lines.count_on(_NO_TURN), lines.count_on(turn)
    size = math.degrees(float(np.linalg.norm(turn)))
    clear = after >= max(before + _MIN_MORE_ON_LINES, _MIN_TIMES_ON_LINES * before)
    return size if clear and is_turned(cameras[row], size) else math.nan


def moments_of(frames: int) -> list[int]:
    """The frames, evenly spread from the first, at which matches are sought where the first has too few."""
    return sorted({frames * k // _MOMENTS for k in range(_MOMENTS)})
