"""The starts of all cameras that agree best with one another, pair by pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .agreement import Agreement

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

_MIN_EVIDENCE = 3.0
"""Of a pair's best lag, to count. Figure: pairs that see nothing but noise and a video's coding have .8 at most."""
_ROUNDS = 30
"""At most so often every camera is moved to where it agrees best with the others."""
_LAG_SOFTENING_FRAMES = 0.25
"""Frames by which a pair may differ from the others' verdict before it counts less."""
_CALIBRATION_EVIDENCE_SHARE = 0.08
"""A calibration with errors changes the evidence for a start by up to this share. At 60 frames a second, a camera in
step has 7 % less evidence at its start than a frame beside it, one that is a frame late 10 to 14 % less in step."""
_VOTE_FRAMES = 1.5
"""Frames around the verdict within which a pair's own best lag is a vote for it."""


@dataclass(frozen=True)
class StartEstimate:
    """The ``starts`` (cameras,) in frames, their standard ``errors``, and ``pair_agreement`` 0..1.

    NaN, NaN and 0 for cameras that no pair links with most others.
    """

    starts: F64
    errors: F64
    pair_agreement: F64


def joint_starts(count: int, pairs: Sequence[Agreement]) -> StartEstimate:
    """The best starts of ``count`` cameras: whole frames that have most evidence, then their fractions."""
    pairs = [pair for pair in pairs if pair.evidence.max() >= _MIN_EVIDENCE]
    groups, tree = _tree(count, pairs)
    linked = groups == np.bincount(groups).argmax()
    if linked.sum() < 2:
        return StartEstimate(np.full(count, np.nan), np.full(count, np.nan), np.zeros(count))
    begun = (tree, np.zeros(count, np.int64))
    whole = max((_settled(starts, pairs) for starts in begun), key=lambda starts: _evidence(starts, pairs))
    starts, errors = _fractions(whole, pairs)
    votes = np.array([_votes(row, whole, pairs) for row in range(count)])
    return StartEstimate(
        np.where(linked, starts, np.nan), np.where(linked, errors, np.nan), np.where(linked, votes, 0.0)
    )


def _lag(pair: Agreement, starts: I64) -> int:
    """The column of a pair's lag at these starts."""
    return int(starts[pair.second] - starts[pair.first]) + len(pair.evidence) // 2


def _at(values: F64, column: int) -> float:
    return float(values[column]) if 0 <= column < len(values) else 0.0


def _evidence(starts: I64, pairs: Sequence[Agreement]) -> float:
    return sum(_at(pair.evidence, _lag(pair, starts)) for pair in pairs)


def _tree(count: int, pairs: Sequence[Agreement]) -> tuple[I64, I64]:
    """Groups of cameras (cameras,) that pairs link, and starts along the pairs whose best lag stands out most."""
    groups, starts = np.arange(count), np.zeros(count, np.int64)
    for pair in sorted(pairs, key=_lead, reverse=True):
        kept, joined = groups[pair.first], groups[pair.second]
        if kept != joined:
            moved = groups == joined
            starts[moved] += int(np.argmax(pair.evidence)) - _lag(pair, starts)
            groups[moved] = kept
    return groups, starts


def _lead(pair: Agreement) -> float:
    """The evidence of the best lag over that of any that is not beside it."""
    best = int(np.argmax(pair.evidence))
    others = np.delete(pair.evidence, range(max(0, best - 1), min(len(pair.evidence), best + 2)))
    return float(pair.evidence[best] - others.max(initial=0.0))


def _settled(starts: I64, pairs: Sequence[Agreement]) -> I64:
    """Every camera in turn where it has most evidence, until none moves."""
    starts = starts.copy()
    for _ in range(_ROUNDS):
        before = starts.copy()
        for row in range(len(starts)):
            starts[row] = _best(row, starts, pairs)
        if (before == starts).all():
            break
    return starts


def _best(row: int, starts: I64, pairs: Sequence[Agreement]) -> int:
    """A camera's start that has most evidence, the others given; its own where none has any."""
    sums: dict[int, float] = {}
    for pair in pairs:
        if row not in (pair.first, pair.second):
            continue
        reach, is_first = len(pair.evidence) // 2, row == pair.first
        other = int(starts[pair.second if is_first else pair.first])
        for column in np.flatnonzero(pair.evidence).tolist():
            start = other + (reach - column if is_first else column - reach)
            sums[start] = sums.get(start, 0.0) + float(pair.evidence[column])
    return max(sums, key=lambda start: (sums[start], -abs(start - starts[row])), default=int(starts[row]))


def _fractions(whole: I64, pairs: Sequence[Agreement]) -> tuple[F64, F64]:
    """The starts by least squares over the pairs' peaks, and their standard errors."""
    peaks = [peak for pair in pairs if (peak := _peak(pair, _lag(pair, whole))) is not None]
    if not peaks:
        return whole.astype(np.float64), np.full(len(whole), np.nan)
    system = np.zeros((len(peaks), len(whole)))
    for row, peak in zip(system, peaks, strict=True):
        row[peak.second], row[peak.first] = 1, -1
    lags, bends = system @ whole + [peak.at for peak in peaks], np.array([peak.bend for peak in peaks])
    # Weak enough to move nothing that a pair says, and needed since only differences count.
    tie = 1e-3 * float(np.median(bends)) * np.eye(len(whole))
    starts, weights = whole.astype(np.float64), bends
    for _ in range(10):
        normal = system.T @ (weights[:, None] * system) + tie
        starts = np.linalg.solve(normal, system.T @ (weights * lags) + tie @ whole)
        apart = np.abs(system @ starts - lags)
        weights = bends / np.maximum(1, apart / _LAG_SOFTENING_FRAMES)
    evidence = np.array([peak.evidence for peak in peaks])
    return starts, np.array([_error(np.flatnonzero(own), apart, weights, bends, evidence) for own in system.T])


def _error(own: I64, apart: F64, weights: F64, bends: F64, evidence: F64) -> float:
    """Standard error of a camera's start: by what its pairs differ, and by how little they notice. NaN for one pair.

    Pairs share their faults, so that they differ by half of what they are wrong.
    """
    if len(own) < 2:
        return np.nan
    scatter = (weights[own] * apart[own] ** 2).sum() / weights[own].sum() / (len(own) - 1)
    unnoticed = _CALIBRATION_EVIDENCE_SHARE * 2 * evidence[own].sum() / bends[own].sum()
    return float(np.sqrt(4 * scatter + unnoticed / 4))


@dataclass(frozen=True)
class _Peak:
    """A pair's best lag near the one found: how far from it, the evidence there, and how much it bends."""

    first: int
    second: int
    at: float
    evidence: float
    bend: float


def _peak(pair: Agreement, column: int) -> _Peak | None:
    """The top of a parabola through three correlations; None if there is none nearby."""
    if not 0 < column < len(pair.evidence) - 1:
        return None
    before, here, after = pair.correlation[column - 1 : column + 2].tolist()
    bend = -float(np.diff(pair.evidence[column - 1 : column + 2], 2)[0])
    if not (before - 2 * here + after < 0 and bend > 0):
        return None
    top = (before - after) / 2 / (before - 2 * here + after)
    return _Peak(pair.first, pair.second, top, float(pair.evidence[column]), bend) if abs(top) <= _VOTE_FRAMES else None


def _votes(row: int, whole: I64, pairs: Sequence[Agreement]) -> float:
    """The share of a camera's pairs, by their evidence, whose own best lag is the one found."""
    own = [pair for pair in pairs if row in (pair.first, pair.second)]
    evidence = np.array([pair.evidence.max() for pair in own])
    votes = np.array([abs(int(np.argmax(pair.evidence)) - _lag(pair, whole)) <= _VOTE_FRAMES for pair in own])
    return float((evidence * votes).sum() / evidence.sum()) if len(own) else 0.0
