"""The keyframe's weight of structure follows how many views confirm a surface."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.encoder.keyframe.few_views import dissimilarity_for
from decogs.encoder.keyframe.first_points import FirstPoints
from decogs.encoder.settings.presets import LADDER, PRESETS


def points(*views_of_each: int) -> FirstPoints:
    """Points that so many of eight views confirm."""
    count = len(views_of_each)
    seen = np.arange(8)[:, None] < np.array(views_of_each)
    three, one = np.zeros((count, 3), np.float32), np.ones(count, np.float32)
    return FirstPoints(three, three, one, one, seen, seen.any(axis=0))


@pytest.mark.parametrize(
    ("views_of_each", "expected"),
    [
        ((2, 2, 2), 0.05),
        ((1, 2, 2), 0.05),
        ((3, 4), 0.125),
        ((5, 5), 0.2),
        ((8, 6, 7), 0.2),
        ((6, 0, 0, 6), 0.2),
        ((0, 0), 0.05),
    ],
    ids=["two", "fewer", "halfway", "five", "more", "guesses do not count", "guesses alone"],
)
def test_structure_weighs_less_the_fewer_views_confirm_a_point(views_of_each: tuple[int, ...], expected: float) -> None:
    assert dissimilarity_for(points(*views_of_each), 0.05) == pytest.approx(expected)


def test_the_ladder_follows_the_views_and_the_papers_preset_does_not() -> None:
    for name in LADDER:
        few = PRESETS[name].keyframe.few_views_dissimilarity
        assert dissimilarity_for(points(2), few) < dissimilarity_for(points(5), few)
    paper = PRESETS["paper"].keyframe.few_views_dissimilarity
    assert dissimilarity_for(points(2), paper) == dissimilarity_for(points(5), paper) == 0.2
