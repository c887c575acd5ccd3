"""Frames per second as exact fractions, however they are written: 25, 29.97, 30000/1001."""

from __future__ import annotations

import math
import re
from fractions import Fraction

_MAX_DENOMINATOR = 1001
_TYPED_DIGITS = range(2, 7)
"""Decimals to which people and programs round 30000/1001."""
_SAME = 1e-5
"""Relative difference of rates that are one: half a frame of 30 a second after 28 minutes; clocks differ by more."""
_FRACTION = re.compile(r"[0-9]{1,9}/[0-9]{1,9}", re.ASCII)


def exact_rate(fps: float) -> Fraction:
    """The fraction that a positive rate stands for: 30000/1001 for 29.97, else the nearest of a small denominator."""
    rate, broadcast = Fraction(fps), Fraction(1000 * round(fps * 1.001), 1001)
    is_rounded = any(round(float(broadcast), digits) == fps for digits in _TYPED_DIGITS)
    if rate.denominator != 1 and (is_rounded or _are_close(fps, float(broadcast))):
        return broadcast
    return rate.limit_denominator(_MAX_DENOMINATOR) if rate >= 1 else 1 / (1 / rate).limit_denominator(_MAX_DENOMINATOR)


def is_same_rate(one: float, other: float) -> bool:
    """Whether two rates are one, as 29.97 and 30000/1001 are."""
    return exact_rate(one) == exact_rate(other) or _are_close(one, other)


def read_rate(text: str) -> float | None:
    """Frames per second as people write them, a number or a fraction such as 30000/1001; None for what is no rate."""
    fraction = _FRACTION.fullmatch(text)
    try:
        rate = float(Fraction(text)) if fraction else float(text) if text.isascii() and "_" not in text else math.nan
    except (ValueError, ZeroDivisionError):
        rate = math.nan
    return rate if 0 < rate < math.inf else None


def _are_close(one: float, other: float) -> bool:
    return math.isclose(one, other, rel_tol=_SAME)
