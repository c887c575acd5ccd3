"""Streams in layers: all together are the single layer's Gaussians, and the base plays whatever happens to the rest."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.packets.refinement import read_refinement
from decogs.codec.packets.syntax import refers_to_first
from decogs.codec.scene.state import ARRAYS, same_values
from decogs.decoder.reading.damage import Damage
from decogs.decoder.reading.info import info
from decogs.decoder.reading.info_text import summary_lines
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import FRAME_KINDS, Packet, PacketKind, StreamWriter
from edited_streams import states_of
from layered_streams import ONE_IN, layered, rows_of, some_of
from packets import iterate_packets

SOURCES = ["small_stream", "segmented_stream", "tiny_stream"]


@pytest.fixture(params=SOURCES)
def both(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """A stream, and the same in layers."""
    single = request.getfixturevalue(request.param).path
    return single, layered(single, tmp_path / "layered.dgs", refreshed=4)


def packets_of(path: Path) -> list[Packet]:
    with path.open("rb") as file:
        return list(iterate_packets(file))


def rewritten(path: Path, packets: list[Packet], version: tuple[int, int] = (1, 1)) -> Path:
    """The packets under a new index."""
    head, *others = packets
    with path.open("wb") as file:
        writer = StreamWriter(file, head.payload, version)
        for packet in others:
            if packet.kind not in (PacketKind.INDEX, PacketKind.LAYERS, PacketKind.END):
                writer.write(packet.kind, packet.frame, packet.payload)
        writer.finish()
    return path


def test_all_layers_together_are_the_single_layers_gaussians(both: tuple[Path, Path]) -> None:
    single, layers = both
    with open_stream(single, strict=True) as one, open_stream(layers, strict=True) as other:
        assert other.version == (1, 1)
        for expected, frame in zip(one.frames(), other.frames(), strict=True):
            np.testing.assert_array_equal(rows_of(frame.state), rows_of(expected.state))
            assert (np.diff(frame.state.ids) > 0).all()
            assert (frame.kind == PacketKind.KEY) == (expected.kind == PacketKind.KEY)
            assert frame.kind != PacketKind.SKIP or expected.kind == PacketKind.SKIP


def test_the_base_alone_has_its_own_values(both: tuple[Path, Path]) -> None:
    single, layers = both
    with open_stream(layers, strict=True, layer="base") as stream:
        for state, frame in zip(states_of(single), stream.frames(), strict=True):
            expected = some_of(state, is_late=frame.index >= 4)
            np.testing.assert_array_equal(rows_of(frame.state), rows_of(expected))


def test_any_range_is_read_as_in_order(both: tuple[Path, Path]) -> None:
    _, layers = both
    with open_stream(layers, strict=True) as stream:
        whole = [frame.state for frame in stream.frames()]
        for start in range(stream.frame_count):
            for frame in stream.frames(start, min(start + 2, stream.frame_count)):
                assert same_values(frame.state, whole[frame.index])


def test_each_segment_has_its_base_before_what_refines_it(both: tuple[Path, Path]) -> None:
    kinds = [packet.kind for packet in packets_of(both[1])]
    assert PacketKind.REFINE in kinds
    assert kinds[-2:] == [PacketKind.LAYERS, PacketKind.END]
    refines_before = False
    for kind in kinds:
        if kind in FRAME_KINDS:
            assert kind == PacketKind.KEY or not refines_before
            refines_before = False
        refines_before |= kind == PacketKind.REFINE


def test_layers_are_chosen_by_name_or_number(both: tuple[Path, Path]) -> None:
    single, layers = both
    for name, is_base in (("base", True), (0, True), ("0", True), (1, False), ("all", False), (None, False)):
        with open_stream(layers, layer=name) as stream, open_stream(single) as whole:
            frame, all_of_it = next(stream.frames()), next(whole.frames())
            assert (len(frame.state) < len(all_of_it.state)) == is_base
            assert (frame.blocks is None) == is_base
    for name in ("2", "top", -1, ""):
        with pytest.raises(UsageError, match="no such layer"):
            open_stream(layers, layer=name)
    with pytest.raises(UsageError, match="has one layer"):
        open_stream(single, layer=1)


def test_facts_name_the_layers(both: tuple[Path, Path]) -> None:
    facts = info(both[1], strict=True)
    base, whole = facts.header.layers
    assert base.gaussians < whole.gaussians == max(frame.gaussians for frame in facts.frames)
    assert whole.bytes_per_frame == pytest.approx(sum(frame.bytes for frame in facts.frames) / len(facts.frames))
    assert sum(facts.byte_table.totals) == facts.file_bytes
    assert next(line for line in summary_lines(facts) if line.startswith("layer")).endswith("30.0 dB of the whole")
    assert facts.to_json()["header"]["layers"][0]["psnr"] == 30.0


def test_keyframes_that_refer_to_the_first_say_offsets_once(segmented_stream, tmp_path: Path) -> None:
    """But for those of Gaussians that came since."""
    packets = packets_of(layered(segmented_stream.path, tmp_path / "layered.dgs"))
    refined = {packet.frame: read_refinement(packet) for packet in packets if packet.kind == PacketKind.REFINE}
    (first,) = refined[0].alignments
    referring = [packet.frame for packet in packets if refers_to_first(packet)]
    assert first is not None
    assert referring
    for frame in referring:
        (again,) = refined[frame].alignments
        assert again is None or len(again.payload) < len(first.payload) / 2


# --- damage ---------------------------------------------------------------------------------------------------------


def shown(path: Path, **options: object) -> tuple[list[int], list[Damage]]:
    """How many Gaussians each frame shows, and what was reported."""
    damages: list[Damage] = []
    with open_stream(path, on_damage=damages.append, **options) as stream:  # type: ignore[arg-type]
        return [len(frame.state) for frame in stream.frames()], damages


def base_sizes(path: Path) -> list[int]:
    with open_stream(path, layer="base") as stream:
        return [len(frame.state) for frame in stream.frames()]


@pytest.mark.parametrize("harm", ["changed", "lost"])
def test_a_damaged_refinement_costs_no_frame_of_the_base(both: tuple[Path, Path], tmp_path: Path, harm: str) -> None:
    """From there on the base is shown, up to the next keyframe; everything before and after is whole."""
    layers = both[1]
    whole, _ = shown(layers)
    base, packets = base_sizes(layers), packets_of(layers)
    skipped = {packet.frame for packet in packets if packet.kind == PacketKind.SKIP}
    keys = [packet.frame for packet in packets if packet.kind == PacketKind.KEY]
    for place, packet in enumerate(packets):
        # Where the base's packet says that nothing changes, that of a layer is missed only by the next digest.
        if packet.kind != PacketKind.REFINE or (harm == "lost" and packet.frame in skipped):
            continue
        broken = tmp_path / "broken.dgs"
        if harm == "lost":
            rewritten(broken, packets[:place] + packets[place + 1 :])
        else:
            data = bytearray(layers.read_bytes())
            data[packet.offset + 20 + len(packet.payload) // 2] ^= 0x41
            broken.write_bytes(data)
        following = next((key for key in keys if key > packet.frame), len(whole))
        expected = whole[: packet.frame] + base[packet.frame : following] + whole[following:]
        found, damages = shown(broken)
        if packet.frame:
            assert found == expected
        else:  # later keyframes may refer to this one
            assert found[:1] == base[:1]
            assert all(size in pair for size, *pair in zip(found, base, whole, strict=True))
        assert f"from frame {packet.frame} on the base alone is shown" in str(damages[0])
        with pytest.raises(StreamError), open_stream(broken, strict=True) as stream:
            list(stream.frames())
        assert shown(broken, layer="base")[0] == base


def test_a_cut_tail_leaves_the_base(both: tuple[Path, Path], tmp_path: Path) -> None:
    layers = both[1]
    base, packets = base_sizes(layers), packets_of(layers)
    last = [packet for packet in packets if packet.kind in FRAME_KINDS][-1]
    cut = tmp_path / "cut.dgs"
    cut.write_bytes(layers.read_bytes()[: last.offset + last.size + 10])
    found, _ = shown(cut)
    assert len(found) == len(base)
    assert found[-1] == base[-1]


def test_every_byte_of_a_refinement_may_be_wrong(tiny_stream, tmp_path: Path) -> None:
    """Checksums are mended, so that only the contents are wrong: an error of the stream, or the very same Gaussians."""
    layers = layered(tiny_stream.path, tmp_path / "layered.dgs")
    expected, packets = [rows_of(state) for state in states_of(layers)], packets_of(layers)
    places = [place for place, packet in enumerate(packets) if packet.kind == PacketKind.REFINE]
    for place in places:
        packet = packets[place]
        for at in range(len(packet.payload)):
            wrong = bytes(v ^ (0xFF if k == at else 0) for k, v in enumerate(packet.payload))
            broken = rewritten(
                tmp_path / "broken.dgs",
                [*packets[:place], Packet(9, packet.frame, wrong, False), *packets[place + 1 :]],
            )
            try:
                found = [rows_of(state) for state in states_of(broken)]
            except StreamError:
                continue
            for one, other in zip(found, expected, strict=True):
                np.testing.assert_array_equal(one, other)


def test_a_list_of_layers_out_of_bounds_counts_as_none(both: tuple[Path, Path], tmp_path: Path) -> None:
    packets = packets_of(both[1])
    for wrong in (b'"layers":{}', b'"layers":[]', b'"layers":[1,2]', b'"layers":[{"gaussians":-1}]'):
        text = packets[0].payload
        begin = text.index(b'"layers":')
        end = text.index(b"]", begin) + 1
        head = Packet(1, 0, text[:begin] + wrong + text[end:])
        path = rewritten(tmp_path / "other.dgs", [head, *packets[1:]])
        with open_stream(path, strict=True) as stream:
            assert stream.header.layers == ()
            assert len(next(stream.frames()).state) == base_sizes(both[1])[0]


def test_the_plain_decoder_says_the_same(both: tuple[Path, Path]) -> None:
    """It is written from SPEC.md alone."""
    sys.path.insert(0, str(Path(__file__).parents[2] / "conformance"))
    import plain_layers

    blocks = plain_layers.decode_layers(both[1].read_bytes())
    with open_stream(both[1], strict=True) as stream:
        for expected, frame in zip(blocks, stream.frames(), strict=True):
            assert frame.blocks is not None
            for one, other in zip(expected, frame.blocks, strict=True):
                assert one.ids == other.ids.tolist()
                assert one.next_id == other.next_id
                columns = [getattr(other, name).reshape(len(other), -1) for name in ARRAYS]
                assert one.rows == np.concatenate(columns, axis=1).astype(int).tolist()


def test_one_in_four_is_in_the_base(small_stream, tmp_path: Path) -> None:
    layers = layered(small_stream.path, tmp_path / "layered.dgs")
    state = states_of(small_stream.path)[0]
    assert base_sizes(layers)[0] == (state.ids % ONE_IN == 0).sum()
