"""Damaged streams: what is lost, what is held and said, what is an error, and that no wrong scene is ever shown."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import warnings
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from damaged_streams import EVERY, WHERE, flipped, frame_packet, shown
from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import Delta, apply_delta
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.scene.lattice import default_lattice
from decogs.codec.scene.state import GROUPS, Attributes, group_columns
from decogs.decoder import DamageWarning, info
from decogs.decoder.commands import decode_main, export_main, info_main
from decogs.decoder.reading.damage import Damage
from decogs.decoder.reading.stream import open_stream
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import (
    PACKET_HEADER_SIZE,
    PROLOGUE_SIZE,
    PacketKind,
    StreamWriter,
    index_payload,
    packet_bytes,
    read_index,
)
from decogs.formats.stream.reasons import DAMAGE
from decogs.formats.stream.survey import MAX_LOST_FRAMES, lost_frames_within
from packets import iterate_packets


def read(path: Path, start: int = 0, stop: int | None = None, **options) -> tuple[list, list[Damage]]:
    damage: list[Damage] = []
    with open_stream(path, on_damage=damage.append, **options) as stream:
        return list(stream.frames(start, stop)), damage


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize(
    ("frame", "scenes"),
    [
        (1, [0, 0, 0, 0, 4, 5, 6, 7]),
        (2, [0, 1, 1, 1, 4, 5, 6, 7]),
        (3, [0, 1, 2, 2, 4, 5, 6, 7]),
        (4, [0, 1, 2, 3, 3, 3, 3, 3]),
        (5, [0, 1, 2, 3, 4, 4, 4, 4]),
        (7, [0, 1, 2, 3, 4, 5, 6, 6]),
    ],
)
@pytest.mark.parametrize("indexed", [True, False])
def test_a_damaged_packet_costs_the_rest_of_its_segment(
    small_stream, packets, where: str, frame: int, scenes: list[int], indexed: bool
) -> None:
    path, packet = small_stream.path, frame_packet(packets, frame)
    if not indexed:
        data = path.read_bytes()
        path.write_bytes(data[: packets[-2].offset])
    flipped(path, packet.offset + WHERE[where])
    frames, damage = read(path)
    if frame == 7 and not indexed:
        # Nothing tells that there was a frame 7, but the damage itself is told.
        assert shown(frames, small_stream) == scenes[:7]
        assert (list(damage[0].frames), damage[0].held) == ([], None)
    else:
        assert shown(frames, small_stream) == scenes
        lost = [index for index in range(8) if scenes[index] != index]
        assert (list(damage[0].frames), damage[0].held) == (lost, frame - 1)
    assert len(damage) == 1
    assert damage[0].error.offset == packet.offset
    assert damage[0].error.packet == frame + 1
    assert damage[0].error.reason in ("bad-sync", "bad-header-crc", "bad-payload-crc")
    with pytest.raises(StreamError) as caught, open_stream(path, strict=True) as stream:
        list(stream.frames())
    error = caught.value
    assert (error.reason, error.offset) == (damage[0].error.reason, packet.offset)
    # The tail behind the last intact packet header is read by itself, where packets are not counted.
    assert error.packet == (None if (frame, where, indexed) == (7, "payload", False) else frame + 1)


@pytest.mark.parametrize("where", WHERE)
def test_nothing_can_be_held_before_the_first_keyframe(small_stream, packets, where: str) -> None:
    flipped(small_stream.path, frame_packet(packets, 0).offset + WHERE[where])
    with pytest.raises(StreamError, match=r"in packet 1 at byte 1"):
        read(small_stream.path, 0, 1)
    frames, damage = read(small_stream.path, 4)
    assert shown(frames, small_stream) == [4, 5, 6, 7]
    assert damage == []


def test_a_lost_first_keyframe_names_the_next_one(small_stream, packets) -> None:
    path, key = small_stream.path, frame_packet(packets, 0)
    data = path.read_bytes()
    path.write_bytes(data[: key.offset] + data[key.offset + key.size :])
    with pytest.raises(StreamError, match=r"first intact one is frame 4; choose frames from there on .*missing-key"):
        read(path)
    frames, _ = read(path, 4)
    assert shown(frames, small_stream) == [4, 5, 6, 7]


@pytest.mark.parametrize("start", [4, 5, 7])
def test_a_range_whose_keyframe_is_damaged_is_held_from_the_segment_before(small_stream, packets, start: int) -> None:
    flipped(small_stream.path, frame_packet(packets, 4).offset + WHERE["payload"])
    frames, damage = read(small_stream.path, start)
    assert shown(frames, small_stream) == [3] * (8 - start)
    assert [(list(d.frames), d.held) for d in damage] == [([4, 5, 6, 7], 3)]


def test_two_damaged_places_are_told_apart(small_stream, packets) -> None:
    for frame in (2, 5):
        flipped(small_stream.path, frame_packet(packets, frame).offset + WHERE["length"])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == [0, 1, 1, 1, 4, 4, 4, 4]
    assert [(list(d.frames), d.held) for d in damage] == [([2, 3], 1), ([5, 6, 7], 4)]
    flipped(small_stream.path, frame_packet(packets, 4).offset + WHERE["payload"])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == [0, 1] + [1] * 6
    assert [(list(d.frames), d.held) for d in damage] == [([2, 3], 1), ([4, 5, 6, 7], 1)]


def test_a_digest_that_does_not_fit_is_damage_too(small_stream, packets) -> None:
    data = small_stream.path.read_bytes()
    for frame in (1, 4):
        packet = frame_packet(packets, frame)
        mended = packet_bytes(packet.kind, frame, bytes([packet.payload[0] ^ 1]) + packet.payload[1:])
        data = data[: packet.offset] + mended + data[packet.offset + packet.size :]
        small_stream.path.write_bytes(data)
        frames, damage = read(small_stream.path)
        scenes = {1: [0, 0, 0, 0, 4, 5, 6, 7], 4: [0] * 8}[frame]
        assert shown(frames, small_stream) == scenes
        expected = {1: [([1, 2, 3], 0)], 4: [([1, 2, 3], 0), ([4, 5, 6, 7], 0)]}[frame]
        assert [(list(d.frames), d.held) for d in damage] == expected
        assert {d.error.reason for d in damage} == {"digest-mismatch"}
    frames, damage = read(small_stream.path, 6)
    assert shown(frames, small_stream) == [0, 0]
    assert [list(d.frames) for d in damage] == [[1, 2, 3], [4, 5, 6, 7]]


@pytest.mark.parametrize("also_damaged", [False, True])
def test_the_end_packet_tells_of_a_missing_last_frame(small_stream, packets, also_damaged: bool) -> None:
    last = frame_packet(packets, 7)
    data = small_stream.path.read_bytes()
    small_stream.path.write_bytes(data[: last.offset] + data[last.offset + last.size :])
    if also_damaged:
        flipped(small_stream.path, frame_packet(packets, 2).offset + WHERE["sync"])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == ([0, 1, 1, 1] if also_damaged else [0, 1, 2, 3]) + [4, 5, 6, 6]
    assert [(list(d.frames), d.held) for d in damage][-1] == ([7], 6)
    with pytest.raises(StreamError), open_stream(small_stream.path, strict=True):
        pass


@pytest.mark.parametrize(
    ("first", "last", "scenes"), [(1, 1, [0, 0, 0, 0]), (2, 3, [0, 1, 1, 1]), (1, 3, [0, 0, 0, 0])]
)
@pytest.mark.parametrize("part", ["packets", "into the next"])
def test_bytes_missing_in_the_middle(small_stream, packets, first: int, last: int, scenes: list, part: str) -> None:
    start, end = frame_packet(packets, first), frame_packet(packets, last)
    cut = (start.offset, end.offset + end.size) if part == "packets" else (start.offset + 9, end.offset + 30)
    data = small_stream.path.read_bytes()
    small_stream.path.write_bytes(data[: cut[0]] + data[cut[1] :])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == [*scenes, 4, 5, 6, 7]
    assert (list(damage[0].frames), damage[0].held) == (list(range(first, 4)), first - 1)
    with pytest.raises(StreamError), open_stream(small_stream.path, strict=True) as stream:
        list(stream.frames())


def test_a_hole_that_reaches_past_the_end_of_the_file_is_searched_past(small_stream, packets) -> None:
    """The header of the big keyframe 4 stays, most of its payload goes: it claims more bytes than there are."""
    key = frame_packet(packets, 4)
    data = small_stream.path.read_bytes()[: packets[-2].offset]
    small_stream.path.write_bytes(data[: key.offset + 40] + data[key.offset + key.size :])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == [0, 1, 2, 3, 3, 3, 3, 3]
    assert damage[0].error.reason == "truncated"


@pytest.mark.parametrize("which", [-2, -1])
@pytest.mark.parametrize("where", WHERE)
def test_a_damaged_index_costs_no_frame(small_stream, packets, which: int, where: str) -> None:
    flipped(small_stream.path, packets[which].offset + WHERE[where])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == list(range(8))
    assert [list(d.frames) for d in damage] == [[]]
    assert damage[0].error.offset == packets[which].offset
    with pytest.raises(StreamError) as caught:
        open_stream(small_stream.path, strict=True)
    assert caught.value.offset == packets[which].offset


def test_a_damaged_packet_for_people_costs_no_frame(small_stream, packets) -> None:
    data, at = small_stream.path.read_bytes(), frame_packet(packets, 3).offset
    metrics = bytearray(packet_bytes(PacketKind.METRICS, 2, b"{}" * 20))
    metrics[30] ^= 1
    small_stream.path.write_bytes(data[:at] + metrics + data[at : packets[-2].offset])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == list(range(8))
    assert [(list(d.frames), d.error.offset) for d in damage] == [([], at)]
    with pytest.raises(StreamError, match="bad-payload-crc"), open_stream(small_stream.path, strict=True) as stream:
        list(stream.frames())


def test_bytes_after_the_end_are_told(small_stream) -> None:
    size = small_stream.path.stat().st_size
    with small_stream.path.open("ab") as file:
        file.write(packet_bytes(PacketKind.METRICS, 0, b"late"))
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == list(range(8))
    assert [(d.error.reason, d.error.offset) for d in damage] == [("trailing-data", size)]


@pytest.mark.parametrize("part", ["prologue", "header packet", "header text"])
def test_a_damaged_header_cannot_be_concealed(small_stream, part: str) -> None:
    offsets = {"prologue": 9, "header packet": PROLOGUE_SIZE + 9, "header text": PROLOGUE_SIZE + 60}
    flipped(small_stream.path, offsets[part])
    with pytest.raises(StreamError, match=r"\[bad-(header|payload)-crc\]"):
        read(small_stream.path)


def test_what_a_reader_cannot_show_is_never_concealed(small_stream, packets) -> None:
    """A mode of a later version, a limit, a critical packet that is unknown: the scene is not damaged, but foreign."""
    data, delta = small_stream.path.read_bytes(), frame_packet(packets, 5)
    tag = bytearray(delta.payload)
    tag[8] = 77
    foreign = data[: delta.offset] + packet_bytes(delta.kind, 5, bytes(tag)) + data[delta.offset + delta.size :]
    critical = data[: delta.offset] + packet_bytes(90, 5, b"", critical=True) + data[delta.offset : packets[-2].offset]
    for content, reason in ((foreign, "unsupported-mode"), (critical, "unknown-critical")):
        small_stream.path.write_bytes(content)
        with pytest.raises(StreamError) as caught:
            read(small_stream.path)
        assert caught.value.reason == reason
        assert reason not in DAMAGE


def test_a_stream_cannot_claim_endless_lost_frames(small_stream, packets) -> None:
    data = small_stream.path.read_bytes()[: packets[-2].offset]
    most = lost_frames_within(9)
    assert most == 1024 + 9 * 64 < lost_frames_within(1 << 20) == MAX_LOST_FRAMES
    for frame, fits in ((8 + most, True), (9 + most, False)):
        late = packet_bytes(PacketKind.SKIP, frame, struct.pack("<Q", 0))
        small_stream.path.write_bytes(data + late)
        if fits:
            with open_stream(small_stream.path) as stream:
                assert stream.frame_count == frame + 1
        else:
            with pytest.raises(StreamError, match="frames are missing, above the limit"):
                open_stream(small_stream.path)


def test_an_index_that_leads_astray_is_passed_over(small_stream, packets) -> None:
    """Its checksum is right, what it says is not; strictly read it is an error, else the packet headers are scanned."""
    data = small_stream.path.read_bytes()
    with small_stream.path.open("rb") as file:
        entries = read_index(file)
    end = packets[-1].payload
    wrong = {
        "all": [replace(entry, offset=entry.offset + 1) for entry in entries],
        "one": [replace(entry, offset=entry.offset + 7 * (entry.frame == 5)) for entry in entries],
        "kinds": [replace(entry, kind={2: 3, 3: 2}.get(entry.kind, entry.kind)) for entry in entries],
        "numbers": [replace(entry, frame=entry.frame + 4 * (entry.frame == 7)) for entry in entries],
    }
    for name, listed in wrong.items():
        index = packet_bytes(PacketKind.INDEX, 0, index_payload(listed))
        small_stream.path.write_bytes(data[: packets[-2].offset] + index + packet_bytes(PacketKind.END, 0, end))
        for start in range(8):
            frames, damage = read(small_stream.path, start)
            assert shown(frames, small_stream) == list(range(start, 8)), name
            assert [list(d.frames) for d in damage] in ([], [[]]), "no frame is lost by it"
        told = [d.error.reason for d in read(small_stream.path)[1]]
        assert told == ([] if name == "numbers" else ["index-mismatch"])
        if name != "numbers":
            with pytest.raises(StreamError), open_stream(small_stream.path, strict=True) as stream:
                list(stream.frames())


def test_a_wrong_index_hides_no_damage(small_stream, packets) -> None:
    data, delta = small_stream.path.read_bytes(), frame_packet(packets, 5)
    with small_stream.path.open("rb") as file:
        listed = [replace(entry, offset=entry.offset + 1) for entry in read_index(file)]
    index = packet_bytes(PacketKind.INDEX, 0, index_payload(listed))
    end = packet_bytes(PacketKind.END, 0, packets[-1].payload)
    small_stream.path.write_bytes(data[: packets[-2].offset] + index + end)
    flipped(small_stream.path, delta.offset + WHERE["payload"])
    frames, damage = read(small_stream.path)
    assert shown(frames, small_stream) == [0, 1, 2, 3, 4, 4, 4, 4]
    assert [list(d.frames) for d in damage] == [[], [5, 6, 7]]


def test_forged_headers_inside_each_other_do_not_make_the_search_quadratic(small_stream) -> None:
    """Each of 20 000 headers claims the rest of the file: without a bound, 10 GB would be summed."""
    data, count = small_stream.path.read_bytes(), 20_000
    forged = bytearray()
    for i in range(count):
        length = (count - i) * PACKET_HEADER_SIZE - PACKET_HEADER_SIZE
        head = struct.pack("<4sBBHII", b"DGSP", 3, 1, 0, 1, max(0, length - 4))
        forged += head + struct.pack("<I", zlib.crc32(head))
    small_stream.path.write_bytes(data[:-36] + forged)
    with pytest.raises(StreamError, match=r"overlap|too many places"):
        open_stream(small_stream.path)


def test_without_a_listener_damage_is_a_warning(small_stream, packets) -> None:
    flipped(small_stream.path, frame_packet(packets, 5).offset + WHERE["payload"])
    with open_stream(small_stream.path) as stream:
        with pytest.warns(DamageWarning, match=r"scene\.dgs: .* \[bad-payload-crc\]; frames 5 to 7 show frame 4"):
            list(stream.frames())
        with warnings.catch_warnings(record=True) as again:
            list(stream.frames())
    assert again == [], "a place is told of once for each opening"


def test_decoding_a_damaged_stream_warns_and_holds(small_stream, packets, tmp_path: Path, capsys) -> None:
    scene, out = str(small_stream.path), tmp_path / "o"
    flipped(small_stream.path, frame_packet(packets, 3).offset + WHERE["payload"])
    assert decode_main([scene, "--view", "cam00", "-o", str(out)]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    offset = frame_packet(packets, 3).offset
    assert f"wrong in packet 4 at byte {offset} [bad-payload-crc]; frame 3 shows frame 2" in said
    pictures = [cv2.imread(str(out / f"cam00_{t:06d}.png")) for t in range(8)]
    assert np.array_equal(pictures[3], pictures[2])
    assert not np.array_equal(pictures[4], pictures[3])
    assert export_main([scene, "-o", str(tmp_path / "s.usda")]) == 0
    assert capsys.readouterr().err.count("frame 3 shows frame 2") == 1, "told once, though the frames are read twice"
    for command, arguments in ((decode_main, ["--view", "cam00", "-o", str(tmp_path / "p")]), (info_main, [])):
        assert command([scene, *arguments, "--strict"]) == 2
        printed = capsys.readouterr()
        assert (printed.out, printed.err.count("\n")) == ("", 1)
        assert f"in packet 4 at byte {offset} [bad-payload-crc]" in printed.err
    assert not (tmp_path / "p").exists()


def test_info_reports_damage(small_stream, packets, capsys) -> None:
    packet = frame_packet(packets, 2)
    flipped(small_stream.path, packet.offset + WHERE["payload"])
    facts = info(small_stream.path)
    assert [frame.kind for frame in facts.frames] == ["key", "delta", "lost", "lost", "key", "delta", "skip", "skip"]
    assert (facts.totals["lost_frames"], facts.totals["skip_frames"]) == (2, 2)
    assert sum(facts.totals["bytes_by_purpose"].values()) == facts.file_bytes
    assert info_main([str(small_stream.path), "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)["damage"]
    assert reported[0].pop("message").endswith("[bad-payload-crc]")
    assert reported == [
        {"frames": [2, 4], "held": 1, "packet": 3, "offset": packet.offset, "reason": "bad-payload-crc"}
    ]
    assert info_main([str(small_stream.path)]) == 0
    table = capsys.readouterr().out
    assert "8 (2 key, 2 delta, 2 skip, 2 lost) at 25 fps" in table
    assert f"at byte {packet.offset} [bad-payload-crc]; frames 2 to 3 show frame 1" in table


@pytest.mark.parametrize("step", EVERY)
def test_a_cut_gives_the_right_prefix_or_an_error(tiny_stream, step: int) -> None:
    """A prefix is the frames whose packets are complete, nothing else; a tail inside a packet is told."""
    data = tiny_stream.path.read_bytes()
    with tiny_stream.path.open("rb") as file:
        header_end = read_index(file)[0].offset
        file.seek(0)
        packets = list(iterate_packets(file))
    ends = [p.offset + p.size for p in packets if p.kind in (2, 3, 4)]
    whole = {header_end, *(p.offset + p.size for p in packets)}
    for size in range(0, len(data), step):
        tiny_stream.path.write_bytes(data[:size])
        if size < header_end:
            with pytest.raises(StreamError, match=r"tiny\.dgs: .*truncated"):
                read(tiny_stream.path)
            continue
        complete = sum(end <= size for end in ends)
        with open_stream(tiny_stream.path, on_damage=pytest.fail) as stream:
            assert (stream.frame_count, stream.complete) == (complete, False)
            assert (stream.unfinished_bytes > 0) == (size not in whole)
            frames = list(stream.frames())
        assert [frame.state.row_sum for frame in frames] == [s.row_sum for s in tiny_stream.states[:complete]]
        if size not in whole:
            with pytest.raises(StreamError, match=r"truncated") as caught:
                open_stream(tiny_stream.path, strict=True)
            assert caught.value.offset is not None


@pytest.mark.parametrize("step", EVERY)
def test_a_flipped_bit_never_shows_a_wrong_scene(tiny_stream, step: int) -> None:
    """Strictly read, always an error with its offset; else what is shown is right, or held and said to be."""
    data = tiny_stream.path.read_bytes()
    with tiny_stream.path.open("rb") as file:
        first_frame_ends = read_index(file)[1].offset
    held = 0
    for position in range(0, len(data), step):
        damaged = bytearray(data)
        damaged[position] ^= 1 << position % 8
        tiny_stream.path.write_bytes(damaged)
        with pytest.raises(StreamError) as caught, open_stream(tiny_stream.path, strict=True) as stream:
            list(stream.frames())
        assert caught.value.offset is not None
        if position < first_frame_ends:
            with pytest.raises(StreamError, match=r"at byte \d+"):
                read(tiny_stream.path)
            continue
        frames, damage = read(tiny_stream.path)
        assert len(damage) == 1
        assert len(frames) == len(tiny_stream.states)
        scenes = shown(frames, tiny_stream)
        held += scenes != list(range(len(scenes)))
    assert held > 200 // step


def test_the_memory_limit_holds_for_the_largest_scene_it_lets_in(tmp_path: Path) -> None:
    """In a process of its own: the greatest growth of its memory while every frame is decoded, activated, accounted."""
    limit, cost = 64 << 20, 15 * (4 * 14 + 16)
    count = limit // cost
    program = f"""
import re
from pathlib import Path
from decogs.decoder.reading.stream import open_stream

def peak():
    return int(re.search("VmHWM: *\t* *([0-9]+) kB", Path("/proc/self/status").read_text())[1]) << 10

before = peak()
with open_stream({str(tmp_path / "big.dgs")!r}, max_memory={limit}, strict=True) as stream:
    kinds = [(frame.kind.name, len(frame.splats), frame.changes.added) for frame in stream.frames()]
print(kinds, peak() - before)
"""
    write_big_stream(tmp_path / "big.dgs", count)
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    kinds, grown = printed.rsplit(" ", 1)
    assert kinds == str([("KEY", count, count), ("DELTA", count, count), ("DELTA", count, 0)])
    assert 0.3 * limit < int(grown) < limit
    write_big_stream(tmp_path / "big.dgs", count + 1)
    with pytest.raises(StreamError, match="too-many-gaussians"):
        read(tmp_path / "big.dgs", max_memory=limit)


def write_big_stream(path: Path, count: int) -> None:
    """A keyframe; all of it moved, removed and replaced; all of it moved. Values that hardly compress."""
    random = np.random.default_rng(1)

    def draw(rows: int) -> Attributes:
        shapes = ((3,), (3,), (4,), (), (1, 3))
        return Attributes(*(random.integers(-(1 << 30), 1 << 30, (rows, *shape)).astype(np.int32) for shape in shapes))

    everything = np.arange(count)
    camera = Camera("a", 16, 12, 15.0, 15.0, 8.0, 6.0, np.eye(4))
    state, _ = keyframe_state(draw(count))
    with path.open("wb") as file:
        writer = StreamWriter(file, StreamHeader(cameras=(camera,), lattice=default_lattice(2.0)).to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state, level=1).payload)
        for frame, removed, added in ((1, everything, draw(count)), (2, everything[:0], draw(0))):
            moves = draw(count)
            residuals = {group: group_columns(moves, group) for group in GROUPS[:5]}
            delta = Delta(everything, residuals, removed, added)
            writer.write(PacketKind.DELTA, frame, write_delta(state, delta, level=1).payload)
            state = apply_delta(state, delta)
        writer.finish()
