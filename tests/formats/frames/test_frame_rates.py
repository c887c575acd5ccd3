"""Frames per second as exact fractions, whichever way they are written."""

from __future__ import annotations

from fractions import Fraction

import pytest

from decogs.formats.frames.rates import exact_rate, is_same_rate, read_rate


@pytest.mark.parametrize(
    ("fps", "rate"),
    [
        (29.97, "30000/1001"),
        (30000 / 1001, "30000/1001"),
        (29.97003, "30000/1001"),
        (29.9701, "30000/1001"),  # as milliseconds in a Matroska file have it
        (23.976, "24000/1001"),
        (23.98, "24000/1001"),
        (59.94, "60000/1001"),
        (119.88, "120000/1001"),
        (14.985, "15000/1001"),
        (30, "30"),
        (25, "25"),
        (999, "999"),
        (12.5, "25/2"),
        (29.98, "1499/50"),
        (0.1, "1/10"),
        (1e-6, "1/1000000"),
    ],
)
def test_a_rate_stands_for_a_fraction(fps: float, rate: str) -> None:
    assert exact_rate(fps) == Fraction(rate)


def test_rates_within_rounding_are_one() -> None:
    assert is_same_rate(29.97, 30000 / 1001)
    assert is_same_rate(23.98, 23.976)
    assert not is_same_rate(29.97, 30)
    assert not is_same_rate(25, 24)


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        ("30000/1001", 30000 / 1001),
        ("29.97", 29.97),
        ("25", 25.0),
        ("0", None),
        ("-1", None),
        ("1/0", None),
        ("nan", None),
        ("inf", None),
        ("1e400", None),
        ("30000/1001/2", None),
        ("3_0", None),
        ("\N{ARABIC-INDIC DIGIT THREE}", None),
        ("", None),
    ],
)
def test_rates_are_read_as_people_write_them(text: str, rate: float | None) -> None:
    assert read_rate(text) == rate
