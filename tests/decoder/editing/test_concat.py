"""Streams behind each other: scenes to the bit on one lattice, rounded to it from another, and one list of cameras."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.scene.lattice import dequantise, quantise
from decogs.codec.scene.state import empty_attributes, take_rows
from decogs.decoder.editing import Concat, Trim, edit
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter
from edited_streams import assert_same_scenes, assert_same_values, bodies, header_of, states_of


def write_two_frames(path: Path, header: StreamHeader, splats: Splats) -> Path:
    """A scene that stays."""
    state, _ = keyframe_state(quantise(splats, header.lattice))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.write(PacketKind.SKIP, 1, write_skip(state).payload)
        writer.finish()
    return path


def joined(first: Path, *more: Path) -> Path:
    out = first.with_name("joined.dgs")
    edit(first, out, [Concat(more)])
    return out


@pytest.mark.parametrize("kind", ["small_stream", "segmented_stream"])
def test_a_take_twice_has_every_scene_twice(kind: str, request) -> None:
    path = request.getfixturevalue(kind).path
    out, states = joined(path, path), states_of(path)
    found = states_of(out)
    assert_same_scenes(found[: len(states)], states)
    assert_same_values(found[len(states) :], states)
    assert not set(found[0].ids) & set(found[len(states)].ids)
    assert header_of(out).to_bytes() == header_of(path).to_bytes()
    was, now = bodies(path), bodies(out)
    assert now[: len(was)] == was
    for (kind_before, before), (kind_now, after) in zip(was, now[len(was) :], strict=True):
        assert kind_before == kind_now
        if kind_now != PacketKind.KEY:
            assert after[8:] == before[8:], "but for the digest, in which ids are"


def test_ids_follow_each_other_and_name_one_gaussian_each(small_stream) -> None:
    states = states_of(joined(small_stream.path, small_stream.path, small_stream.path))
    ends = [states[7].next_id, states[15].next_id, states[23].next_id]
    assert ends == [ends[0], 2 * ends[0], 3 * ends[0]]
    for number, end in enumerate(ends):
        ids = {int(name) for state in states[8 * number : 8 * number + 8] for name in state.ids}
        assert end - ends[0] <= min(ids) <= max(ids) < end


def test_takes_without_a_gaussian_at_first(small_stream, tmp_path: Path) -> None:
    """Then nothing but its next id tells whose take it is."""
    header = header_of(small_stream.path)
    none, _ = keyframe_state(empty_attributes(4))
    born = difference(
        none, np.zeros(0, int), empty_attributes(4), added=take_rows(small_stream.states[0], np.arange(9))
    )
    path = tmp_path / "empty.dgs"
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(none).payload)
        writer.write(PacketKind.DELTA, 1, write_delta(none, born).payload)
        writer.finish()
    assert_same_values(states_of(joined(path, path)), states_of(path) * 2)


def test_pieces_of_a_take_in_another_order(segmented_stream, tmp_path: Path) -> None:
    path, states = segmented_stream.path, states_of(segmented_stream.path)
    edit(path, tmp_path / "late.dgs", [Trim(slice(12, 17))])
    edit(path, tmp_path / "out.dgs", [Trim(slice(3, 8)), Concat((tmp_path / "late.dgs",)), Trim(slice(2, 9))])
    assert_same_values(states_of(tmp_path / "out.dgs"), [*states[5:8], *states[12:16]])


def test_another_lattice_is_rounded_to_the_first_one_and_what_stays_goes_on_staying(small_stream, tmp_path) -> None:
    header = header_of(small_stream.path)
    steps = header.lattice.means
    other = replace(header, lattice=replace(header.lattice, origin=(0.3, 0.2, 0.1), means=(steps[0] * 0.9,) * 3))
    scene = dequantise(small_stream.states[0], header.lattice)
    path = write_two_frames(tmp_path / "other.dgs", other, scene)
    out = joined(small_stream.path, path)
    found, expected = states_of(out), states_of(path)
    assert_same_scenes(found[:8], states_of(small_stream.path))
    assert [kind for kind, _ in bodies(out)[8:]] == [PacketKind.KEY, PacketKind.SKIP]
    for name in ("log_scales", "quaternions", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(found[8], name), getattr(expected[0], name))
    means = [dequantise(found[8], header.lattice).means, dequantise(expected[0], other.lattice).means]
    # Half a step, and the rounding of both to float32 at 2.6 units.
    assert np.abs(means[0] - means[1]).max() <= steps[0] / 2 + 2.6 * 2**-23
    report = edit(small_stream.path, None, [Concat((path,))])
    assert "means rounded to the lattice of the first" in report.notes[0]


@pytest.mark.parametrize("name", ["log_scales", "opacity_logits", "sh_dc", "sh_rest"])
def test_values_of_other_steps_are_rounded_to_the_nearest_of_the_first(name: str, small_stream, tmp_path) -> None:
    header = header_of(small_stream.path)
    step = getattr(header.lattice, name)
    other = replace(header, lattice=replace(header.lattice, **{name: step * 0.7}))
    path = write_two_frames(tmp_path / "other.dgs", other, dequantise(small_stream.states[0], header.lattice))
    found = dequantise(states_of(joined(small_stream.path, path))[8], header.lattice)
    expected = dequantise(states_of(path)[0], other.lattice)
    for array in ("log_scales", "opacity_logits", "sh"):
        # Half a step, and the rounding of both to float32.
        off = np.abs(getattr(found, array) - getattr(expected, array)).max()
        assert off <= (step * 0.501 if name.startswith(array) else 0)


def test_the_higher_degree_counts(small_stream, tmp_path: Path) -> None:
    header = header_of(small_stream.path)
    scene = dequantise(small_stream.states[0], header.lattice)
    path = write_two_frames(tmp_path / "flat.dgs", replace(header, sh_degree=0), replace(scene, sh=scene.sh[:, :1]))
    for out in (joined(small_stream.path, path), joined(path, small_stream.path)):
        assert header_of(out).sh_degree == 1
    found = states_of(joined(path, small_stream.path))
    assert not found[0].sh[:, 1:].any()
    np.testing.assert_array_equal(found[0].sh[:, :1], states_of(path)[0].sh)
    assert_same_values(found[2:], states_of(small_stream.path))


def test_cameras_of_both_are_there_and_one_that_both_have_once(small_stream, tmp_path: Path) -> None:
    header = header_of(small_stream.path)
    turned = replace(header.cameras[0], fx=61.0)
    fourth = replace(header.cameras[0], name="cam03")
    other = replace(header, cameras=(turned, header.cameras[1], fourth), held_out=("cam01", "cam00"), licence="mine")
    path = write_two_frames(tmp_path / "other.dgs", other, dequantise(small_stream.states[0], header.lattice))
    made = header_of(joined(small_stream.path, path))
    assert [camera.name for camera in made.cameras] == ["cam00", "cam01", "wide", "cam00_2", "cam03"]
    assert made.cameras[3].fx == 61.0
    assert made.held_out == ("cam01", "cam00_2")
    assert made.licence == "CC0; mine"


@pytest.mark.parametrize(
    ("change", "message"),
    [({"subject": True}, "subject without a background"), ({"fps": 24.0}, "25 frames a second, the other 24")],
)
def test_what_does_not_go_together_is_refused(change, message: str, small_stream, tmp_path: Path) -> None:
    header = header_of(small_stream.path)
    scene = dequantise(small_stream.states[0], header.lattice)
    path = write_two_frames(tmp_path / "other.dgs", replace(header, **change), scene)
    with pytest.raises(UsageError, match=message):
        joined(small_stream.path, path)
    assert not list(tmp_path.glob("joined*"))


@pytest.mark.parametrize(("one", "other"), [(29.97, 30000 / 1001), (23.98, 23.976)])
def test_rates_within_rounding_go_together(one: float, other: float, small_stream, tmp_path: Path) -> None:
    header = header_of(small_stream.path)
    scene = dequantise(small_stream.states[0], header.lattice)
    paths = [
        write_two_frames(tmp_path / f"{name}.dgs", replace(header, fps=fps), scene)
        for name, fps in (("one", one), ("other", other))
    ]
    assert header_of(joined(*paths)).fps == one
    apart = write_two_frames(tmp_path / "apart.dgs", replace(header, fps=30.0), scene)
    with pytest.raises(UsageError, match=r"one has 30 frames a second, the other 29\.97; "):
        joined(apart, write_two_frames(tmp_path / "typed.dgs", replace(header, fps=29.97), scene))


def test_a_stream_that_is_appended_is_not_written_over(small_stream, segmented_stream) -> None:
    before = segmented_stream.path.read_bytes()
    with pytest.raises(UsageError, match="never replaces what it reads"):
        edit(small_stream.path, segmented_stream.path, [Concat((segmented_stream.path,))])
    assert segmented_stream.path.read_bytes() == before
