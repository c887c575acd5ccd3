"""Retiming: which frame is shown when, and that each of them is the scene it was, to the bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from decogs.codec.scene.state import State
from decogs.decoder.editing import Crop, Retime, Speed, Sphere, Trim, edit
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.editing.operations import retime
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import PacketKind
from edited_streams import bodies, header_of, in_order_of_values, states_of

EIGHT = list(range(8))
CASES = [
    (Retime(fps=24.0), EIGHT),
    (Retime((Speed(0, None, 2, 2),)), [0, 2, 4, 6]),
    (Retime((Speed(0, None, 3, 3),)), [0, 3, 6]),
    (Retime((Speed(2, 4, 0.5, 0.5),)), [0, 1, 2, 2, 3, 3, 4, 5, 6, 7]),
    (Retime((Speed(0, 1, 0.1, 0.1),)), [0] * 10 + EIGHT[1:]),
    (Retime((Speed(1, 6, 4, 4),)), [0, 1, 5, 6, 7]),
    (Retime((Speed(0, None, 2, 2), Speed(4, 8, 1, 1))), [0, 2, 4, 5, 6, 7]),
    # .5 at first, then half a step faster with each fourth of the way: at 0, .5, 1.1875, 2.1328, 3.43, 5.2, 7.65.
    (Retime((Speed(0, 8, 0.5, 3.5),)), [0, 0, 1, 2, 3, 5, 7]),
    (Retime(holds=((3, 2), (0, 1))), [0, 0, 1, 2, 3, 3, 3, 4, 5, 6, 7]),
    (Retime(reverse=True), EIGHT[::-1]),
    (Retime((Speed(0, None, 2, 2),), ((6, 1),), reverse=True), [6, 6, 4, 2, 0]),
    (Retime((Speed(3, 5, 0.5, 0.5),), reverse=True), [7, 6, 5, 4, 4, 3, 3, 2, 1, 0]),
]


def assert_shows(found: list[State], states: list[State], numbers: list[int]) -> None:
    """The frames of these numbers, their Gaussians in any order."""
    assert len(found) == len(numbers)
    for state, number in zip(found, numbers, strict=True):
        now, was = ([values for values, _ in in_order_of_values(each)] for each in (state, states[number]))
        assert now == was


@pytest.mark.parametrize(("operation", "numbers"), CASES)
def test_frames_are_shown_when_they_are_asked_for(operation: Retime, numbers: list[int], small_stream) -> None:
    out = small_stream.path.with_name("out.dgs")
    edit(small_stream.path, out, [operation])
    assert_shows(states_of(out), states_of(small_stream.path), numbers)
    kinds = [kind for kind, _ in bodies(out)]
    segments = [number // 4 for number in numbers]
    begins = [not place or segments[place] != segments[place - 1] for place in range(len(numbers))]
    assert [kind == PacketKind.KEY for kind in kinds] == begins
    for place in range(1, len(numbers)):
        if numbers[place] == numbers[place - 1]:
            assert kinds[place] == PacketKind.SKIP
    assert header_of(out).fps == (operation.fps or 25.0)


def test_a_rate_alone_changes_no_packet(segmented_stream, tmp_path: Path) -> None:
    edit(segmented_stream.path, tmp_path / "out.dgs", [Retime(fps=50.0)])
    assert bodies(tmp_path / "out.dgs") == bodies(segmented_stream.path)


def test_there_and_back_is_the_take(segmented_stream, tmp_path: Path) -> None:
    edit(segmented_stream.path, tmp_path / "out.dgs", [Retime(reverse=True), Retime(reverse=True)])
    assert_shows(states_of(tmp_path / "out.dgs"), states_of(segmented_stream.path), list(range(20)))


def test_an_id_is_one_gaussians_for_as_long_as_it_is_there(segmented_stream, tmp_path: Path) -> None:
    edit(segmented_stream.path, tmp_path / "out.dgs", [Retime(reverse=True)])
    owner: dict[int, int] = {}
    for now, was in zip(states_of(tmp_path / "out.dgs"), states_of(segmented_stream.path)[::-1], strict=True):
        for (_, name), (_, own) in zip(in_order_of_values(now), in_order_of_values(was), strict=True):
            assert owner.setdefault(name, own) == own


def test_operations_read_any_part_of_a_retimed_take(small_stream, tmp_path: Path) -> None:
    path, slow = small_stream.path, Retime((Speed(2, 6, 0.5, 0.5),), reverse=True)
    shown = [7, 6, 5, 5, 4, 4, 3, 3, 2, 2, 1, 0]
    edit(path, tmp_path / "out.dgs", [slow, Trim(slice(3, 9)), Crop(Sphere((0, 0, 0), 1e6))])
    assert_shows(states_of(tmp_path / "out.dgs"), states_of(path), shown[3:9])


def test_a_segment_too_long_to_be_in_memory_is_refused(small_stream, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(retime, "_MOST_BUFFERED", 10_000)
    with pytest.raises(UsageError, match="a segment of 4 frames is too long to be in memory"):
        edit(small_stream.path, tmp_path / "out.dgs", [Retime(reverse=True)])
    assert not list(tmp_path.glob("out*"))


def test_as_many_frames_as_are_allowed_are_shown(small_stream, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(retime, "_MOST_FRAMES", 10)
    edit(small_stream.path, tmp_path / "out.dgs", [Retime(holds=((7, 2),))])
    assert_shows(states_of(tmp_path / "out.dgs"), states_of(small_stream.path), [*EIGHT, 7, 7])
    with pytest.raises(UsageError, match="more than 10 frames"):
        edit(small_stream.path, None, [Retime(holds=((7, 3),))])


def test_the_command_says_it_in_words(small_stream, tmp_path: Path) -> None:
    words = "retime --speed 2:4=.5 --speed 4:=1>3 --hold 0:2 --reverse --fps 12.5"
    expected = Retime((Speed(2, 4, 0.5, 0.5), Speed(4, None, 1, 3)), ((0, 2),), True, 12.5)
    edit(small_stream.path, tmp_path / "1.dgs", [expected])
    assert edit_main([str(small_stream.path), "-o", str(tmp_path / "2.dgs"), "-q", *words.split()]) == 0
    assert (tmp_path / "1.dgs").read_bytes() == (tmp_path / "2.dgs").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("", "nothing is to be done"),
        ("--speed 2:4=0", "frames 2:4 at 0 to 0 is not possible"),
        ("--speed 2:4=-1", "frames 2:4 at -1 to -1 is not possible"),
        ("--speed 2:4=nan", "is not possible"),
        ("--speed 9:=2", "frames 9: at 2 to 2 is not possible; choose some of 0:8"),
        ("--speed 2=2", "are no range"),
        ("--speed 2:4", "'' is no number"),
        ("--speed -3:=2", "count frames from the take's start"),
        ("--speed 0:=0.0000001", "more than 1000 frames"),
        ("--hold 0:999999999999", "more than 1000 frames"),
        ("--hold 8:1", "a hold of frame 8 for 1 is not possible"),
        ("--hold 3:-1", "a hold of frame 3 for -1 is not possible"),
        ("--hold 3", "'' is no whole number"),
        ("--fps 0", "'0' is no rate"),
    ],
)
def test_what_cannot_be_is_refused(
    words: str, message: str, small_stream, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retime, "_MOST_FRAMES", 1000)
    assert edit_main([str(small_stream.path), "-o", str(tmp_path / "out.dgs"), "retime", *words.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("out*"))
