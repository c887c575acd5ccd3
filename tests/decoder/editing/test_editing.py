"""The frame of edits: operations in their order, packets that stay, files that stay, memory that does not grow."""

from __future__ import annotations

import gc
import io
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.scene.state import State, take_rows
from decogs.decoder.editing import Audio, Cameras, Merge, Set, Trim, edit, read_recipe
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.editing.editing import MAX_OPERATIONS
from decogs.decoder.editing.recipe import parse_operations
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import DecogsError, StreamError, UsageError
from decogs.formats.stream.container import PacketKind, StreamWriter
from edited_streams import assert_same_scenes, bodies, states_of
from packets import iterate_packets
from sounding_streams import with_sound


@pytest.fixture
def closed_stream(small_stream, tmp_path: Path) -> SimpleNamespace:
    """Three segments of three frames that all start from the first keyframe's Gaussians and have young ids far apart.

    What a segment removes comes back in the next one.
    """
    path, header, first = tmp_path / "closed.dgs", small_stream.header, small_stream.states[0]
    born = take_rows(small_stream.states[3], np.arange(58, 62))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for segment in range(3):
            state = replace(first, frame=3 * segment, next_id=max(first.next_id, segment << 33))
            writer.write(PacketKind.KEY, state.frame, write_key(state, first=first if segment else None).payload)
            for frame in (1, 2):
                rows = np.arange(4 * segment + frame, 50, 9)
                current = take_rows(state, rows)
                current = replace(current, means=current.means + np.int32(7 * frame))
                delta = difference(state, rows, current, removed=rows[:2] + 1, added=born if frame == 1 else None)
                writer.write(PacketKind.DELTA, state.frame + 1, write_delta(state, delta).payload)
                state = apply_delta(state, delta)
        writer.finish()
    return SimpleNamespace(path=path)


@pytest.mark.parametrize(("start", "stop"), [(0, 8), (0, 3), (1, 8), (2, 6), (3, 4), (4, 8), (5, 7), (7, 8)])
@pytest.mark.parametrize("kind", ["small_stream", "segmented_stream", "closed_stream"])
def test_trim_keeps_every_scene_to_the_bit(kind: str, start: int, stop: int, request, tmp_path: Path) -> None:
    source = request.getfixturevalue(kind)
    out = tmp_path / "out.dgs"
    edit(source.path, out, [Trim(slice(start, stop))])
    assert_same_scenes(states_of(out), states_of(source.path)[start:stop])
    with open_stream(out) as stream:
        assert stream.header.first_frame == start
    was, now = bodies(source.path)[start:stop], bodies(out)
    assert now[0][0] == PacketKind.KEY
    assert now[1:] == was[1:] or any(kind == PacketKind.KEY for kind, _ in now[1:])
    for (kind_before, before), (kind_now, body) in zip(was[1:], now[1:], strict=True):
        assert kind_now == kind_before
        assert kind_now == PacketKind.KEY or body == before


def test_a_trim_of_everything_is_the_same_stream(segmented_stream, tmp_path: Path) -> None:
    report = edit(segmented_stream.path, tmp_path / "out.dgs", [Trim(None)])
    assert (tmp_path / "out.dgs").read_bytes() == segmented_stream.path.read_bytes()
    assert (report.frame_count, report.kept_packets) == (20, 20)
    assert report.file_bytes == segmented_stream.path.stat().st_size


def test_operations_run_in_their_order(small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [Trim(slice(2, None)), Trim(slice(-3, 5))])
    assert_same_scenes(states_of(tmp_path / "out.dgs"), states_of(small_stream.path)[5:7])


def test_a_pipe_gets_the_bytes_of_the_file(small_stream, tmp_path: Path) -> None:
    piped = io.BytesIO()
    edit(small_stream.path, piped, [Trim(slice(3, 7))])
    edit(small_stream.path, tmp_path / "out.dgs", [Trim(slice(3, 7))])
    assert piped.getvalue() == (tmp_path / "out.dgs").read_bytes()


def test_a_damaged_frame_is_refused_and_can_be_trimmed_away(small_stream, tmp_path: Path) -> None:
    data = bytearray(small_stream.path.read_bytes())
    with small_stream.path.open("rb") as file:
        packet = next(p for p in iterate_packets(file) if p.kind == PacketKind.DELTA and p.frame == 5)
    data[packet.offset + 30] ^= 1
    small_stream.path.write_bytes(data)
    with pytest.raises(StreamError, match="frame 5 is damaged"):
        edit(small_stream.path, tmp_path / "out.dgs", [Trim(None)])
    assert not list(tmp_path.glob("out*"))
    edit(small_stream.path, tmp_path / "out.dgs", [Trim(slice(0, 5))])
    assert len(states_of(tmp_path / "out.dgs")) == 5


def test_memory_does_not_grow_with_the_take(segmented_stream, tmp_path: Path) -> None:
    def most_states(frames: slice) -> int:
        found = {}

        def count(done: int, total: int) -> None:
            if done not in found:
                found[done] = sum(type(thing) is State for thing in gc.get_objects())

        edit(segmented_stream.path, tmp_path / "out.dgs", [Trim(frames)], on_frame=count)
        return max(found.values())

    assert most_states(slice(1, 20)) <= most_states(slice(1, 8))


def test_a_dry_run_says_the_same_and_writes_nothing(small_stream, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out.dgs"
    assert edit_main([str(small_stream.path), "trim", "2:6", "--dry-run"]) == 0
    would = capsys.readouterr().out
    assert not list(tmp_path.glob("out*"))
    assert edit_main([str(small_stream.path), "-o", str(out), "-q", "trim", "2:6"]) == 0
    assert capsys.readouterr().out == would.replace("would be written", str(out))
    assert "trim: frames 2:6 of 8" in would


def test_a_recipe_runs_before_what_is_given(small_stream, tmp_path: Path) -> None:
    recipe = tmp_path / "edits.toml"
    recipe.write_text('operations = ["trim 1:", "trim :-1"]\n')
    assert read_recipe(recipe) == [Trim(slice(1, None)), Trim(slice(None, -1))]
    out = tmp_path / "out.dgs"
    assert edit_main([str(small_stream.path), "-o", str(out), "--recipe", str(recipe), "trim", "2:"]) == 0
    assert_same_scenes(states_of(out), states_of(small_stream.path)[3:7])


@pytest.mark.parametrize(
    ("name", "line", "words"),
    [
        ("r.dgs", "trim 0:1", "-o r.dgs"),
        ("r.png", "clean --picture r.png", "-o x.dgs"),
        ("r.toml", "trim 0:1", "-o r.toml"),
        ("r", "clean --picture link.png", "-o x.dgs"),
    ],
)
def test_a_recipe_is_never_written_over(
    name: str, line: str, words: str, small_stream, tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    text = f'operations = ["{line}"]\n'
    Path(name).write_text(text)
    Path("link.png").hardlink_to(name)
    assert edit_main([str(small_stream.path), "--recipe", name, *words.split()]) == 2
    assert "is read, and an edit never replaces what it reads" in capsys.readouterr().err
    assert Path(name).read_text() == text
    assert not Path("x.dgs").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no recipe"),
        ("operations = []", "no recipe"),
        ("operations = [3]", "no recipe"),
        ('operations = [" "]', "no recipe"),
        ('operations = ["trim"]', "trim: the following arguments are required: A:B"),
        ('operations = ["trim \'0:3"]', "No closing quotation"),
        ('operations = ["blur 3"]', "blur: there is no such operation"),
        ('operations = ["trim 0:3"]\nother = 1', "'other' is no part of a recipe"),
        ("operations = [", "malformed TOML"),
    ],
)
def test_a_wrong_recipe_says_so(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "edits.toml").write_text(text)
    with pytest.raises(DecogsError, match=message) as error:
        read_recipe(tmp_path / "edits.toml")
    assert "edits.toml" in str(error.value)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("{scene} -o {scene} trim 0:3", "never replaces what it reads"),
        ("{scene} -o {out}", "no operation is given"),
        ("{scene} trim 0:3", "name what to write by -o"),
        ("{scene} -o {out} trim 0:3 --dry-run", "leave out -o"),
        ("{scene} -o {out} trim 8:", "none of its 8 frames"),
        ("{scene} -o {out} trim 1:3 trim 2:", "none of its 2 frames"),
        ("{scene} -o {out} trim 3", "are no range"),
        ("{scene} -o {out} trim 0:3 4", "trim: unrecognized arguments: 4"),
        ("{scene} -o {out}/x.dgs trim 0:3", "no such folder"),
        ("nowhere.dgs -o {out} trim 0:3", "nowhere.dgs: No such file"),
        ("{scene} -o {out} --recipe none.toml", "none.toml: cannot be read"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(words: str, message: str, small_stream, tmp_path: Path, capsys) -> None:
    before = small_stream.path.read_bytes()
    given = words.format(scene=small_stream.path, out=tmp_path / "out.dgs").split()
    assert edit_main(given) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert not list(tmp_path.glob("out*"))
    assert small_stream.path.read_bytes() == before


def test_a_file_named_as_an_operation_is_the_options_value(small_stream, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert edit_main([str(small_stream.path), "-o", "trim", "-q", "trim", "0:2"]) == 0
    assert len(states_of(tmp_path / "trim")) == 2


@pytest.mark.parametrize(
    "words",
    [
        "transform --turn y=nan",
        "transform --turn y=inf",
        "transform --turn y=-inf",
        "transform --turn y=1e300",
        "transform --scale nan",
        "transform --scale inf",
        "transform --shift 1e300,0,0",
        "transform --origin 0,1e300,0",
        "crop sphere 0,0,0 1 --fade 1e-320",
        "crop sphere 0,0,0 1 --fade nan",
        "grade --exposure nan",
        "grade --saturation inf",
        "grade --white nan,1,1",
        "set --near nan",
        "set --near inf",
        "set --background nan,0,0",
        "retime --fps nan",
        "retime --fps inf",
        "retime --speed 0:2=nan",
        "retime --speed 0:2=inf",
        "clean --opacity nan",
        "clean --opacity 2",
        "clean --size inf",
        "clean --isolation nan",
        "audio --position nan,0,0",
        "audio --position 1e300,0,0",
    ],
)
def test_numbers_with_which_nothing_can_be_computed_are_one_line(words: str, small_stream, tmp_path, capsys) -> None:
    stream = with_sound(small_stream.path, tmp_path / "s.dgs")
    assert edit_main([str(stream), "-o", str(tmp_path / "out.dgs"), *words.split()]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words.split()[0] in error
    assert not list(tmp_path.glob("out*"))


def test_as_many_operations_as_are_allowed_run_and_more_are_one_line(small_stream, tmp_path: Path, capsys) -> None:
    recipe = tmp_path / "r.toml"
    out = tmp_path / "out.dgs"
    for line in ("trim 0:", "crop sphere 0,0,0 1e6"):
        recipe.write_text(f"operations = {[line] * MAX_OPERATIONS}")
        assert edit_main([str(small_stream.path), "-o", str(out), "-q", "--recipe", str(recipe), "trim", "0:2"]) == 2
        assert "101 operations are too many; give up to 100 at once" in capsys.readouterr().err
        assert edit_main([str(small_stream.path), "-o", str(out), "-q", "--recipe", str(recipe)]) == 0
        assert len(states_of(out)) == 8


def test_a_stream_of_which_nothing_is_left_says_so(small_stream, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out.dgs"
    assert edit_main([str(small_stream.path), "-o", str(out), "-q", "clean", "--opacity", "1"]) == 0
    assert "warning: no Gaussian is left in any frame" in capsys.readouterr().err
    assert edit_main([str(small_stream.path), "-o", str(out), "-q", "clean", "--opacity", ".5"]) == 0
    assert "no Gaussian" not in capsys.readouterr().err


def test_values_may_be_called_as_operations_are() -> None:
    words = "set --title crop --licence set trim 0:3 cameras --drop trim audio --title clean merge concat set --sour=x"
    assert parse_operations(words.split()) == [
        Set(title="crop", licence="set"),
        Trim(slice(0, 3)),
        Cameras(drop=("trim",)),
        Audio(title="clean"),
        Merge(Path("concat")),
        Set(source_text="x"),
    ]
    assert parse_operations(["set", "--tit", "trim", "trim", ":2"]) == [Set(title="trim"), Trim(slice(None, 2))]


def test_an_unknown_word_is_no_operation() -> None:
    with pytest.raises(UsageError, match="blur: there is no such operation"):
        parse_operations(["blur", "trim", "0:3"])
