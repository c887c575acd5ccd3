"""Names that are numbered by frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from decogs.formats.errors import UsageError
from decogs.formats.frames.names import is_numbered, names_of_frames


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("x_####.ply", "x_1001.ply"),
        ("x_######.ply", "x_001001.ply"),
        ("x#.ply", "x1001.ply"),
        ("x_%06d.exr", "x_001001.exr"),
        ("x_%d_y.exr", "x_1001_y.exr"),
        ("x.$F4.ply", "x.1001.ply"),
        ("x.$F6.ply", "x.001001.ply"),
        ("x_$F.ply", "x_1001.ply"),
    ],
)
def test_the_number_stands_in_its_place(name: str, expected: str) -> None:
    for frames in (1, 7, None):
        assert names_of_frames(Path("a####b") / name, frames)(1001) == expected
    assert is_numbered(Path(name))


@pytest.mark.parametrize("name", ["x.ply", "100%.ply", "x_%04x.ply", "$FRANC.ply", "a%0d.ply"])
def test_other_names_are_those_of_one_file_and_numbered_for_several(name: str) -> None:
    path = Path(name)
    assert not is_numbered(path)
    assert names_of_frames(path, 1)(12) == name
    assert names_of_frames(path, 2)(12) == f"{path.stem}_000012{path.suffix}"
    assert names_of_frames(path, None)(12) == f"{path.stem}_000012{path.suffix}"


def test_a_number_that_is_too_long_is_not_cut() -> None:
    assert names_of_frames(Path("x_##.ply"), 3)(1001) == "x_1001.ply"


@pytest.mark.parametrize("name", ["x_####_%d.ply", "x_##_##.ply", "$F4_$F4.ply"])
def test_two_places_are_one_too_many(name: str) -> None:
    with pytest.raises(UsageError, match=r"2 places for the frame's number; give one, such as x_####\.ply"):
        names_of_frames(Path(name), 3)
