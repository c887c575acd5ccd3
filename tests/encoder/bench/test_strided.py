"""A rig that shows every k-th frame: the same pictures, renumbered from the first one on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from decogs.encoder.bench.strided import strided
from decogs.formats.rigs import open_rig, read_frames


@pytest.mark.parametrize(
    ("first", "stride", "shown"),
    [(0, 2, [0, 2]), (0, 3, [0, 3]), (1, 2, [0, 1, 3]), (2, 5, [0, 1, 2]), (0, 1, [0, 1, 2, 3])],
)
def test_the_same_pictures(moving_rig: Path, first: int, stride: int, shown: list[int]) -> None:
    rig = open_rig(moving_rig)
    view = strided(rig, first, stride)
    assert view.frame_count == len(shown)
    assert {source.frame_count for source in view.sources} == {len(shown)}
    originals = [pictures for _, pictures in read_frames(rig)]
    for index, pictures in read_frames(view):
        for picture, original in zip(pictures, originals[shown[index]], strict=True):
            np.testing.assert_array_equal(picture, original)
    parts = list(read_frames(view, first, len(shown)))
    assert [index for index, _ in parts] == list(range(first, len(shown)))
    np.testing.assert_array_equal(parts[-1][1][0], originals[shown[-1]][0])


def test_the_rate_goes_with_the_stride(moving_rig: Path) -> None:
    rig = open_rig(moving_rig)
    assert rig.fps == 25
    assert strided(rig, 0, 5).fps == 5
    assert strided(rig, 0, 1) is rig
