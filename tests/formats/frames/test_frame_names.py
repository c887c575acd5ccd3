"""Names that are numbered by frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from decogs.formats.errors import UsageError
from decogs.formats.frames.names import is_numbered, names_of_frames, numbered_files


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


def written(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).touch()
    return folder


def test_files_are_found_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    written(tmp_path, "x_0010.ply", "x_0009.ply", "x_011.ply", "y_0011.ply", "x_0011.ply.part")
    found = numbered_files(tmp_path / "x_####.ply")
    assert found == [(9, tmp_path / "x_0009.ply"), (10, tmp_path / "x_0010.ply")]
    written(tmp_path, "z9.ply", "z10.ply", "z11.ply")
    assert [number for number, _ in numbered_files(tmp_path / "z%d.ply")] == [9, 10, 11]


@pytest.mark.parametrize(
    ("names", "name", "said"),
    [
        (["x_0001.ply", "x_0003.ply"], "x_####.ply", r"after x_0001\.ply comes number 3; give every frame once"),
        (["x1.ply", "x01.ply"], "x%d.ply", r"after x01\.ply comes number 1; give every frame once"),
        (["x_0001.ply"], "y_####.ply", r"y_####\.ply: there is no such file"),
        (["x_0001.ply"], "x_0001.ply", "has no place for the frame's number; name the files like x_####"),
        ([], "none/x_####.ply", "none: No such file or directory; give a folder with the files"),
    ],
)
def test_files_that_are_no_sequence_are_refused(tmp_path: Path, names: list[str], name: str, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        numbered_files(written(tmp_path, *names) / name)
