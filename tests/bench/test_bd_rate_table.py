"""BD-rates among the points of a contest."""

from __future__ import annotations

import pytest

from decogs.bench.runs.rivals import RatePoint
from decogs.bench.tables.bd_rates import bd_rate_table, bd_rates


def point(family: str, all_bytes: float, later_bytes: float, psnr: float) -> RatePoint:
    """Where things move, it has no figure, as of a rig in which nothing does."""
    return RatePoint(
        "a label", family, psnr, None, None, None, None, 1, 0.1, 0.2, later_bytes, frame_bytes=all_bytes, read_ms=None
    )


OURS = [point("decogs", 1e4 * 2**k, 1e3 * 2**k, 28.0 + k) for k in range(4)]
TWICE = [point("twice", 2e4 * 2**k, 6e3 * 2**k, 28.0 + k) for k in range(4)]
FEW = [point("few", 1e4, 1e3, 30.0)]


def test_each_family_is_held_against_the_anchor() -> None:
    table = bd_rate_table(bd_rates([*FEW, *OURS, *TWICE], "decogs"))
    assert table[2:] == [
        "| few | 1 point | 0 points | 1 point | 0 points |",
        "| twice | +100.0 % | 0 points | +500.0 % | 0 points |",
    ]
    (_, ours) = bd_rates([*OURS, *FEW, *TWICE], "twice")[::-1]
    assert ours.document()["figures"]["bd_rate"] == pytest.approx(-50)
    assert ours.document()["missing"] == {"bd_rate_dynamic": "0 points", "bd_rate_later_dynamic": "0 points"}
    assert bd_rates([*FEW, *TWICE], "decogs") == []
