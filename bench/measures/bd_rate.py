"""BD-rate: how many bytes more or less one codec takes than another for the same quality, over all that both reach.

The mean distance of two curves of log rate over quality, each interpolated piecewise by cubics (PCHIP), as the sheets
of JCT-VC and JVET do. Chosen: PCHIP written out here rather than the package ``bjontegaard``, which takes scipy for
these lines. Rejected: one cubic through all points (VCEG-M33), which swings between them, and Akima's interpolation,
which is smoother yet gives other figures than the sheets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FEWEST_POINTS = 4
"""Of a curve, as common test conditions have it."""
LEAST_OVERLAP = 0.5
"""Share of the narrower curve's range of quality that both have to have, lest the figure be of its end alone."""

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class CurvePoint:
    """Bytes, more than none, and the quality they buy, such as PSNR in dB."""

    rate: float
    quality: float


@dataclass(frozen=True)
class BDRate:
    """``percent`` more bytes than the anchor's, fewer where negative; None where there is none, and then ``why``."""

    percent: float | None
    why: str = ""


def bd_rate(anchor: Sequence[CurvePoint], other: Sequence[CurvePoint]) -> BDRate:
    """BD-rate of ``other`` against ``anchor``, points in any order; those that others of theirs beat are left out.

    Source: Bjontegaard 2001 (VCEG-M33), interpolated as in JCTVC-L1100.
    """
    curves = [_curve(points) for points in (other, anchor)]
    for curve, whose in zip(curves, ("", " of the anchor"), strict=True):
        if len(curve) < FEWEST_POINTS:
            return BDRate(None, f"{len(curve)} point{'' if len(curve) == 1 else 's'}{whose}")
    lows, highs = ([curve[end].quality for curve in curves] for end in (0, -1))
    low, high = max(lows), min(highs)
    if high - low < LEAST_OVERLAP * min(top - bottom for top, bottom in zip(highs, lows, strict=True)):
        return BDRate(None, f"{max(high - low, 0):.1f} dB in common")
    logs = [_mean_log_rate(curve, low, high) for curve in curves]
    return BDRate(100 * math.expm1(logs[0] - logs[1]))


def _curve(points: Sequence[CurvePoint]) -> list[CurvePoint]:
    """The points that no other one beats in both, from the worst to the best."""
    curve: list[CurvePoint] = []
    for point in sorted(points, key=lambda point: (point.rate, -point.quality)):
        if not curve or point.quality > curve[-1].quality:
            curve.append(point)
    return curve


def _mean_log_rate(curve: Sequence[CurvePoint], low: float, high: float) -> float:
    quality, rates = np.array([point.quality for point in curve]), np.log([point.rate for point in curve])
    return (_integral(quality, rates, high) - _integral(quality, rates, low)) / (high - low)


def _integral(x: Floats, y: Floats, end: float) -> float:
    """Of the piecewise cubic through ``x``, ``y``, (N,), from the first ``x`` to ``end``."""
    slopes, lengths = _slopes(x, y), np.diff(x)
    steep = np.diff(y) / lengths
    square = (3 * steep - 2 * slopes[:-1] - slopes[1:]) / lengths
    cube = (slopes[:-1] - 2 * steep + slopes[1:]) / lengths**2
    t = np.clip(end - x[:-1], 0, lengths)
    return float((y[:-1] * t + slopes[:-1] * t**2 / 2 + square * t**3 / 3 + cube * t**4 / 4).sum())


def _slopes(x: Floats, y: Floats) -> Floats:
    """Of the cubics at the points, (N,), ``y`` rising: no piece leaves what lies between its ends.

    Source: Fritsch and Butland 1984; the ends as in Moler's pchip (Numerical Computing with MATLAB, 3.6).
    """
    h = np.diff(x)
    steep = np.diff(y) / h
    before, after = h[:-1] + 2 * h[1:], 2 * h[:-1] + h[1:]
    inner = (before + after) / (after / steep[1:] + before / steep[:-1])
    ends = (_end_slope(*h[:2], *steep[:2]), _end_slope(*h[:-3:-1], *steep[:-3:-1]))
    return np.concatenate([ends[:1], inner, ends[1:]])


def _end_slope(h: float, next_h: float, steep: float, next_steep: float) -> float:
    """That of a parabola through three points, no less than flat."""
    return max(((2 * h + next_h) * steep - h * next_steep) / (h + next_h), 0.0)
