"""BD-rate: figures that others publish, what follows from the definition, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.bench.measures.bd_rate import BDRate, CurvePoint, bd_rate

ANCHOR = ((9487.76, 40.037), (4593.60, 38.615), (2486.44, 36.845), (1358.24, 34.851))
OTHER = ((9787.80, 40.121), (4469.00, 38.651), (2451.52, 36.970), (1356.24, 34.987))
"""The example of the package `bjontegaard`, whose PCHIP is that of the sheets of JVET."""
LOW_RATES = ((686.76, 40.28), (309.58, 37.18), (157.11, 34.24), (85.95, 31.42))
HALF_BESIDE = ((1000.0, 44.0), (410.0, 39.9), (260.0, 38.0), (210.0, 35.2), (120.0, 35.0))
"""Of another number of points and another range."""


def curve(points: tuple[tuple[float, float], ...]) -> list[CurvePoint]:
    return [CurvePoint(rate, quality) for rate, quality in points]


def percent(anchor: list[CurvePoint], other: list[CurvePoint]) -> float:
    found = bd_rate(anchor, other).percent
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("anchor", "other", "published"),
    [(ANCHOR, OTHER, -4.417485350589045), (LOW_RATES, HALF_BESIDE, -22.077430618314374)],
)
def test_the_figures_are_those_of_other_programs(
    anchor: tuple[tuple[float, float], ...], other: tuple[tuple[float, float], ...], published: float
) -> None:
    """Of `bjontegaard` 1.3.0, method pchip."""
    assert percent(curve(anchor), curve(other)) == pytest.approx(published, rel=1e-9)


def test_twice_the_bytes_for_the_same_quality_are_a_hundred_percent_more() -> None:
    twice = [CurvePoint(2 * point.rate, point.quality) for point in curve(ANCHOR)]
    assert percent(curve(ANCHOR), twice) == pytest.approx(100)
    assert percent(twice, curve(ANCHOR)) == pytest.approx(-50)
    assert percent(twice, twice) == 0


def test_lines_are_compared_where_both_are() -> None:
    """Log rate 0.1 and 0.2 times the quality, from 32 to 38 dB: their mean distance is a tenth of 35."""
    gentle = [CurvePoint(np.exp(0.1 * q), q) for q in (30.0, 33.0, 37.0, 38.0)]
    steep = [CurvePoint(np.exp(0.2 * q), q) for q in (32.0, 34.0, 35.0, 41.0)]
    assert percent(gentle, steep) == pytest.approx(100 * np.expm1(3.5))


def test_the_order_of_points_and_points_that_are_beaten_do_not_matter() -> None:
    beaten = [CurvePoint(2500.0, 36.845), CurvePoint(5000.0, 30.0)]
    assert percent(curve(ANCHOR[::-1]), beaten + curve(OTHER)) == percent(curve(ANCHOR), curve(OTHER))


@pytest.mark.parametrize(
    ("anchor", "other", "why"),
    [
        (ANCHOR, OTHER[:3], "3 points"),
        (ANCHOR, OTHER[:1], "1 point"),
        (ANCHOR[:2], OTHER, "2 points of the anchor"),
        (ANCHOR, (*OTHER[:3], (9787.80, 39.0)), "3 points"),
        (ANCHOR, tuple((rate, quality - 4) for rate, quality in OTHER), "1.3 dB in common"),
        (ANCHOR, tuple((rate, quality - 9) for rate, quality in OTHER), "0.0 dB in common"),
    ],
)
def test_why_there_is_none(
    anchor: tuple[tuple[float, float], ...], other: tuple[tuple[float, float], ...], why: str
) -> None:
    assert bd_rate(curve(anchor), curve(other)) == BDRate(None, why)
