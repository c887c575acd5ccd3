"""A rig played in another timing: the same pictures, renumbered from the first one on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decogs.bench.timing import TIMINGS, retimed
from decogs.formats.rigs import open_rig, read_frames


@pytest.mark.parametrize(
    ("order", "shown"),
    [
        ([0, 2], [0, 2]),
        ([1, 3], [0, 1, 3]),
        ([2], [0, 1, 2]),
        ([0, 1, 2, 3], [0, 1, 2, 3]),
        ([0, 2, 3, 1], [0, 2, 3, 1]),
        ([1, 3, 1, 3, 3], [0, 1, 3, 1, 3, 3]),
    ],
)
def test_the_same_pictures(moving_rig: Path, order: list[int], shown: list[int]) -> None:
    rig, first = open_rig(moving_rig), order[0]
    view = retimed(rig, order)
    assert view.frame_count == len(shown)
    assert {source.frame_count for source in view.sources} == {len(shown)}
    originals = [pictures for _, pictures in read_frames(rig)]
    for index, pictures in read_frames(view):
        for picture, original in zip(pictures, originals[shown[index]], strict=True):
            np.testing.assert_array_equal(picture, original)
    parts = list(read_frames(view, first, len(shown)))
    assert [index for index, _ in parts] == list(range(first, len(shown)))
    np.testing.assert_array_equal(parts[-1][1][0], originals[shown[-1]][0])


def test_the_rate_goes_with_the_first_step(moving_rig: Path) -> None:
    rig = open_rig(moving_rig)
    assert rig.fps == 25
    assert retimed(rig, range(0, rig.frame_count, 2)).fps == 12.5
    assert retimed(rig, range(rig.frame_count)) is rig


def test_timings_are_orders_of_the_recorded_frames() -> None:
    assert TIMINGS["there-and-back"](range(3, 9)) == [3, 5, 7, 8, 6, 4]
    assert TIMINGS["there-and-back"](range(5)) == [0, 2, 4, 3, 1]
    assert TIMINGS["ever-faster"](range(2, 20)) == [2, 3, 4, 6, 8, 11, 14, 18]
    assert TIMINGS["ever-faster"](range(1)) == [0]
