"""Files that a camera lacks amid those of the others."""

from __future__ import annotations

from pathlib import Path

import pytest

from decogs.formats.rigs.gaps import with_gaps
from decogs.formats.rigs.sources import PictureSource


def pictures(camera: str, frames: list[int]) -> PictureSource:
    return PictureSource(Path(camera), tuple(Path(camera) / f"c1_{frame:04d}.png" for frame in frames), 64, 48)


def names(frames: list[int]) -> list[str]:
    """Of the files of a camera with these frames, beside two that have ten."""
    filled = with_gaps([pictures("a", list(range(10))), pictures("b", list(range(10))), pictures("c", frames)])
    assert isinstance(filled[2], PictureSource)
    return [file.name for file in filled[2].files]


@pytest.mark.parametrize("frames", [[0, 1, 2, 3, 5, 6, 7, 8, 9], [0, 3, 4, 7, 9]])
def test_a_gap_gets_the_names_of_files_that_are_not_there(frames: list[int]) -> None:
    assert names(frames) == [f"c1_{frame:04d}.png" for frame in range(10)]


@pytest.mark.parametrize(
    "frames",
    [
        [0, 3, 6, 9],  # most of them: another rate
        [1, 2, 3, 5, 6, 7, 8, 9],  # begins later
        [0, 1, 2, 3, 5, 6, 7, 8],  # ends before
        [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10],  # has more
    ],
)
def test_what_may_be_another_take_stays_as_it_is(frames: list[int]) -> None:
    assert names(frames) == [f"c1_{frame:04d}.png" for frame in frames]
