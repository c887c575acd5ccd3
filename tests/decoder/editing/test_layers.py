"""Edits of streams in layers: the whole scene becomes what it becomes in one layer, and the base goes with it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.scene.state import ARRAYS, State
from decogs.decoder.editing import Concat, Crop, Grade, Merge, Retime, Set, Strip, Transform, Trim, edit
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.editing.operations import OPERATIONS
from decogs.decoder.editing.operations.base import Operation
from decogs.decoder.editing.operations.layer import MakeLayers
from decogs.decoder.editing.regions import region_of
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import UsageError
from edited_streams import header_of, states_of
from layered_streams import layered, rows_of

SOURCES = ["small_stream", "segmented_stream"]
OF_ONE = {
    "trim": Trim(slice(1, 6)),
    "crop": Crop(region_of(["sphere", "0,0,5", "3"])),
    "fade": Crop(region_of(["sphere", "0,0,5", "2"]), fade=2.0),
    "grade": Grade(exposure=0.5),
    "retime": Retime(holds=((2, 3),), reverse=True),
    "transform": Transform(scale=2.0, shift=(1.0, 0.0, 0.0)),
    "set": Set(title="Take 3"),
}


@pytest.fixture(params=SOURCES)
def both(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    single = request.getfixturevalue(request.param).path
    return single, layered(single, tmp_path / "layered.dgs")


def bases_of(path: Path) -> list[State]:
    with open_stream(path, strict=True, layer="base") as stream:
        return [frame.state for frame in stream.frames()]


def assert_same_rows(found: list[State], expected: list[State]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(rows_of(one), rows_of(other))


@pytest.mark.parametrize("name", OF_ONE)
def test_the_whole_scene_is_edited_as_in_one_layer(both: tuple[Path, Path], tmp_path: Path, name: str) -> None:
    single, layers = both
    edit(single, tmp_path / "single.dgs", [OF_ONE[name]])
    edit(layers, tmp_path / "out.dgs", [OF_ONE[name]])
    assert_same_rows(states_of(tmp_path / "out.dgs"), states_of(tmp_path / "single.dgs"))
    assert [layer.psnr for layer in header_of(tmp_path / "out.dgs").layers] == [30.0, None]


def test_the_base_of_frames_that_stay_keeps_its_bits(both: tuple[Path, Path], tmp_path: Path) -> None:
    for operation in (OF_ONE["trim"], OF_ONE["set"]):
        edit(both[1], tmp_path / "out.dgs", [operation])
        expected = bases_of(both[1])[1:6] if operation is OF_ONE["trim"] else bases_of(both[1])
        assert_same_rows(bases_of(tmp_path / "out.dgs"), expected)


def test_what_an_edit_leaves_of_the_base_differs_from_the_whole_as_before(
    both: tuple[Path, Path], tmp_path: Path
) -> None:
    """By offsets of at most 5 steps, each Gaussian's the same in all of its values but for colours beyond degree 0."""
    for name in ("crop", "fade", "grade"):
        out = tmp_path / f"{name}.dgs"
        edit(both[1], out, [OF_ONE[name]])
        with open_stream(out, strict=True) as stream:
            for frame, base in zip(stream.frames(), bases_of(out), strict=True):
                assert frame.blocks is not None
                np.testing.assert_array_equal(frame.blocks[0].ids, base.ids)
                apart = base.means.astype(int) - frame.blocks[0].means
                assert np.abs(apart).max(initial=0) <= 5
                assert (apart == apart[:, :1]).all()
                for array in ARRAYS if name != "grade" else ARRAYS[:4]:
                    other = getattr(base, array).astype(int) - getattr(frame.blocks[0], array)
                    assert (other.reshape(len(base), -1) == apart[:, :1]).all()


@pytest.mark.parametrize("how", [Concat, Merge])
def test_two_takes_in_layers_are_one_in_layers(both: tuple[Path, Path], tmp_path: Path, how: type[Operation]) -> None:
    single, layers = both

    def operation(path: Path) -> Operation:
        return Concat((path,)) if how is Concat else Merge(path)

    edit(single, tmp_path / "single.dgs", [operation(single)])
    edit(layers, tmp_path / "out.dgs", [operation(layers)])
    assert_same_rows(states_of(tmp_path / "out.dgs"), states_of(tmp_path / "single.dgs"))
    twice = bases_of(layers)
    sizes = [len(state) for state in twice + twice] if how is Concat else [2 * len(state) for state in twice]
    assert [len(state) for state in bases_of(tmp_path / "out.dgs")] == sizes


@pytest.mark.parametrize("turned", [False, True])
def test_where_one_take_has_no_layers_the_result_has_none(
    both: tuple[Path, Path], tmp_path: Path, turned: bool
) -> None:
    first, second = both[::-1] if turned else both
    report = edit(first, tmp_path / "out.dgs", [Concat((second,))])
    assert "both without layers" in report.notes[0]
    assert header_of(tmp_path / "out.dgs").layers == ()
    edit(both[0], tmp_path / "single.dgs", [Concat((both[0],))])
    assert_same_rows(states_of(tmp_path / "out.dgs"), states_of(tmp_path / "single.dgs"))


def test_layers_can_be_taken_off(both: tuple[Path, Path], tmp_path: Path) -> None:
    edit(both[1], tmp_path / "out.dgs", [Strip(("layers",))])
    with open_stream(tmp_path / "out.dgs", strict=True) as stream:
        assert stream.version == (1, 0)
        assert stream.unknown_parts() == []
    assert_same_rows(states_of(tmp_path / "out.dgs"), states_of(both[0]))


def test_an_edit_refuses_frames_whose_layers_are_damaged(both: tuple[Path, Path], tmp_path: Path, capsys) -> None:
    from packets import iterate_packets

    with both[1].open("rb") as file:
        refinement = next(packet for packet in iterate_packets(file) if packet.kind == 9 and packet.frame)
    data = bytearray(both[1].read_bytes())
    data[refinement.offset + 30] ^= 1
    broken = tmp_path / "broken.dgs"
    broken.write_bytes(data)
    assert edit_main([str(broken), "-o", str(tmp_path / "out.dgs"), "set", "--title", "x", "-q"]) == 2
    assert f"frame {refinement.frame} is damaged; trim it away" in capsys.readouterr().err
    assert not (tmp_path / "out.dgs").exists()


def test_layering_says_what_it_needs(small_stream, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert OPERATIONS["layer"] is MakeLayers
    for share in (0.0, 1.0, -1.0):
        with pytest.raises(UsageError, match="layer: "):
            edit(small_stream.path, tmp_path / "out.dgs", [MakeLayers(share)])
    monkeypatch.setattr("decogs.decoder.editing.operations.layer.entry_points", lambda group: [])
    with pytest.raises(UsageError, match="needs the encoder"):
        edit(small_stream.path, tmp_path / "out.dgs", [MakeLayers()])


def test_what_lies_between_base_and_whole_becomes_part_of_what_refines_the_base(tmp_path: Path) -> None:
    sys.path.insert(0, str(Path(__file__).parents[2] / "conformance"))
    import make_vectors

    three, out = tmp_path / "three.dgs", tmp_path / "out.dgs"
    three.write_bytes(make_vectors.kept("1.1")["good/three-layers.dgs"])
    edit(three, out, [Set(title="x")])
    assert [layer.psnr for layer in header_of(out).layers] == [30.25, None]
    assert_same_rows(states_of(out), states_of(three))
    assert_same_rows(bases_of(out), bases_of(three))
