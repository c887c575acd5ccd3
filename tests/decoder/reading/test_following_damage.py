"""Damage in streams that are followed: what is held and said, and that it is what an opened file would show."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from typing import Any

import pytest

from damaged_streams import EVERY, WHERE, frame_packet, shown
from decogs.decoder import DamageWarning
from decogs.decoder.reading.damage import Damage
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import Packet, PacketKind, packet_bytes, read_index
from decogs.formats.stream.survey import MAX_DAMAGED_PLACES, lost_frames_within
from packets import iterate_packets

Told = tuple[list[int], int | None, bool]


def follow(data: bytes, **options: Any) -> tuple[list[DecodedFrame], list[Damage]]:
    damage: list[Damage] = []
    with follow_stream(io.BytesIO(data), on_damage=damage.append, **options) as stream:
        return list(stream.frames()), damage


def told(damage: Sequence[Damage]) -> list[Told]:
    """The frames known to be lost, the one shown, and whether it goes on beyond."""
    return [(list(d.frames), d.held, d.onward) for d in damage]


def hit(data: bytes, offset: int) -> bytes:
    return data[:offset] + bytes([data[offset] ^ 4]) + data[offset + 1 :]


def without(data: bytes, first: Packet, last: Packet) -> bytes:
    return data[: first.offset] + data[last.offset + last.size :]


def mended(data: bytes, packet: Packet) -> bytes:
    """With another digest in the packet, and a checksum that fits it."""
    other = packet_bytes(packet.kind, packet.frame, bytes([packet.payload[0] ^ 1]) + packet.payload[1:])
    return data[: packet.offset] + other + data[packet.offset + packet.size :]


@pytest.fixture
def data(small_stream: Any) -> bytes:
    return bytes(small_stream.path.read_bytes())


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize(
    ("frame", "scenes", "lost"),
    [
        (1, [0, 0, 0, 0, 4, 5, 6, 7], ([1], 0, True)),
        (2, [0, 1, 1, 1, 4, 5, 6, 7], ([2], 1, True)),
        (3, [0, 1, 2, 2, 4, 5, 6, 7], ([3], 2, False)),
        (4, [0, 1, 2, 3, 3, 3, 3, 3], ([4], 3, True)),
        (7, [0, 1, 2, 3, 4, 5, 6, 6], ([7], 6, False)),
    ],
)
def test_a_damaged_packet_costs_the_rest_of_its_segment(
    small_stream: Any, packets: list[Packet], data: bytes, where: str, frame: int, scenes: list[int], lost: Told
) -> None:
    offset = frame_packet(packets, frame).offset
    damaged = hit(data, offset + WHERE[where])
    frames, damage = follow(damaged)
    assert shown(frames, small_stream) == scenes
    assert told(damage) == [lost]
    assert (damage[0].error.offset, damage[0].error.packet) == (offset, frame + 1)
    assert {f.concealed for f in frames if f.concealed} == {damage[0]}
    with pytest.raises(StreamError) as caught:
        follow(damaged, strict=True)
    assert (caught.value.reason, caught.value.offset) == (damage[0].error.reason, offset)


@pytest.mark.parametrize("step", EVERY)
def test_a_flipped_bit_never_shows_a_wrong_scene(tiny_stream: Any, step: int) -> None:
    """Strictly followed, always an error with its offset; else what is shown is right, or held and said to be."""
    data, path = tiny_stream.path.read_bytes(), tiny_stream.path
    with path.open("rb") as file:
        first_frame_ends = read_index(file)[1].offset  # type: ignore[index]
    assert [frame.refers_to_first for frame in follow(data)[0]] == [False] * 5 + [True, False]
    held = 0
    for position in range(0, len(data), step):
        damaged = bytearray(data)
        damaged[position] ^= 1 << position % 8
        with pytest.raises(StreamError) as caught:
            follow(bytes(damaged), strict=True)
        assert caught.value.offset is not None
        if position < first_frame_ends:
            with pytest.raises(StreamError, match=r"-: .*at byte \d+"):
                follow(bytes(damaged))
            continue
        frames, damage = follow(bytes(damaged))
        assert len(damage) == 1
        scenes = shown(frames, tiny_stream)
        path.write_bytes(damaged)
        with open_stream(path, on_damage=damage.append) as stream:
            assert scenes == shown(list(stream.frames()), tiny_stream), "what is opened shows the same"
        held += scenes != list(range(len(scenes)))
    assert held > 200 // step


@pytest.mark.parametrize("step", EVERY)
def test_a_cut_gives_the_right_prefix_or_an_error(tiny_stream: Any, step: int) -> None:
    data = tiny_stream.path.read_bytes()
    packets = list(iterate_packets(io.BytesIO(data)))
    ends = [p.offset + p.size for p in packets]
    for size in range(0, len(data), step):
        if size < ends[0]:
            with pytest.raises(StreamError, match=r"truncated"):
                follow(data[:size])
            continue
        complete = sum(p.frame < 7 and p.kind in (2, 3, 4) and p.offset + p.size <= size for p in packets)
        frames, damage = follow(data[:size])
        assert damage == []
        assert [frame.state.row_sum for frame in frames] == [s.row_sum for s in tiny_stream.states[:complete]]
        assert all(frame.concealed is None for frame in frames)
        if size not in ends:
            with pytest.raises(StreamError, match=r"stops \d+ bytes into a packet.*truncated"):
                follow(data[:size], strict=True)


@pytest.mark.parametrize(
    ("first", "last", "scenes", "lost"),
    [
        (1, 1, [0, 0, 0, 0, 4, 5, 6, 7], ([1], 0, True)),
        (2, 3, [0, 1, 1, 1, 4, 5, 6, 7], ([2, 3], 1, False)),
        (4, 4, [0, 1, 2, 3, 3, 3, 3, 3], ([4], 3, True)),
        (6, 7, [0, 1, 2, 3, 4, 5, 5, 5], ([6, 7], 5, False)),
    ],
)
def test_packets_that_are_missing(
    small_stream: Any, packets: list[Packet], data: bytes, first: int, last: int, scenes: list[int], lost: Told
) -> None:
    damaged = without(data, frame_packet(packets, first), frame_packet(packets, last))
    frames, damage = follow(damaged)
    assert shown(frames, small_stream) == scenes
    assert told(damage) == [lost]
    reason = "index-mismatch" if last == 7 else "frame-order"
    with pytest.raises(StreamError, match=rf"-: .*in packet {8 if last == 7 else first + 1} .*{reason}"):
        follow(damaged, strict=True)


def test_a_hole_is_searched_past_even_if_it_reaches_beyond_the_end(
    small_stream: Any, packets: list[Packet], data: bytes
) -> None:
    """The header of the big keyframe 4 stays, most of its payload goes: it claims more bytes than there are."""
    key = frame_packet(packets, 4)
    damaged = data[: key.offset + 40] + data[key.offset + key.size :]
    frames, damage = follow(damaged)
    assert shown(frames, small_stream) == [0, 1, 2, 3, 3, 3, 3, 3]
    assert told(damage) == [([4], 3, True)]
    assert damage[0].error.reason == "truncated"


def test_a_keyframe_told_against_the_first_ends_the_hold(segmented_stream: Any) -> None:
    data = segmented_stream.path.read_bytes()
    packets = list(iterate_packets(io.BytesIO(data)))
    for frame in (7, 10):
        data = hit(data, frame_packet(packets, frame).offset + WHERE["payload"])
    frames, damage = follow(data)
    assert shown(frames, segmented_stream) == [*range(7), *[6] * 8, *range(15, 20)]
    assert told(damage) == [([7], 6, True), ([10], 6, True)]


def test_a_digest_that_does_not_fit_is_damage_too(small_stream: Any, packets: list[Packet], data: bytes) -> None:
    damaged = mended(data, frame_packet(packets, 1))
    frames, damage = follow(damaged)
    assert shown(frames, small_stream) == [0, 0, 0, 0, 4, 5, 6, 7]
    assert told(damage) == [([1], 0, True)]
    frames, damage = follow(mended(damaged, frame_packet(packets, 4)))
    assert shown(frames, small_stream) == [0] * 8
    assert told(damage) == [([1], 0, True), ([4], 0, True)]
    assert {d.error.reason for d in damage} == {"digest-mismatch"}
    with pytest.raises(StreamError, match="digest-mismatch"):
        follow(damaged, strict=True)


def test_a_packet_that_comes_again_is_passed_over(small_stream: Any, packets: list[Packet], data: bytes) -> None:
    again, at = frame_packet(packets, 1), frame_packet(packets, 4).offset
    repeated = data[again.offset : again.offset + again.size]
    frames, damage = follow(data[:at] + repeated + data[at:])
    assert shown(frames, small_stream) == list(range(8))
    assert [(d.error.reason, d.error.offset) for d in damage] == [("frame-order", at)]
    assert told(damage) == [([], None, False)]


@pytest.mark.parametrize("frame", [0, 3])
def test_what_holds_no_frame_costs_none(small_stream: Any, packets: list[Packet], data: bytes, frame: int) -> None:
    at = frame_packet(packets, frame).offset
    metrics = packet_bytes(PacketKind.METRICS, 2, b"{}" * 20)
    damaged = data[:at] + hit(metrics, 30) + data[at:]
    for place, content in ((at, damaged), *((p.offset, hit(data, p.offset + 25)) for p in packets[-2:])):
        frames, damage = follow(content)
        assert shown(frames, small_stream) == list(range(8))
        assert told(damage) == [([], None, False)]
        assert damage[0].error.offset == place
        assert str(damage[0]).endswith("[bad-payload-crc]; no frame is known to be lost by it")
    frames, damage = follow(data + metrics)
    assert shown(frames, small_stream) == list(range(8))
    assert [(d.error.reason, d.error.offset) for d in damage] == [("trailing-data", len(data))]


def test_damage_that_nothing_follows_is_told(small_stream: Any, packets: list[Packet], data: bytes) -> None:
    """Without an end packet nobody knows whether there was a frame 7."""
    last = frame_packet(packets, 7)
    frames, damage = follow(hit(data[: last.offset + last.size], last.offset + WHERE["payload"]))
    assert shown(frames, small_stream) == list(range(7))
    assert told(damage) == [([], None, False)]


@pytest.mark.parametrize("where", WHERE)
def test_nothing_can_be_held_before_the_first_keyframe(packets: list[Packet], data: bytes, where: str) -> None:
    key = frame_packet(packets, 0)
    for damaged in (
        hit(data, key.offset + WHERE[where]),
        hit(data[: key.offset + key.size], key.offset + WHERE[where]),
    ):
        with pytest.raises(StreamError, match=r"-: .* in packet 1 at byte 1"):
            follow(damaged)
    with pytest.raises(StreamError, match=r"frame 1 where frame 0 must come in packet 1 .*frame-order"):
        follow(without(data, key, key))
    with pytest.raises(StreamError, match=r"in packet 1 .*digest-mismatch"):
        follow(mended(data, key))


def test_what_a_reader_cannot_show_is_never_concealed(packets: list[Packet], data: bytes) -> None:
    delta = frame_packet(packets, 5)
    tag = bytearray(delta.payload)
    tag[8] = 77
    foreign = data[: delta.offset] + packet_bytes(delta.kind, 5, bytes(tag)) + data[delta.offset + delta.size :]
    critical = data[: delta.offset] + packet_bytes(90, 5, b"", critical=True) + data[delta.offset :]
    for content, reason in ((foreign, "unsupported-mode"), (critical, "unknown-critical")):
        with pytest.raises(StreamError) as caught:
            follow(content)
        assert caught.value.reason == reason


def test_lost_frames_and_damaged_places_are_bounded(packets: list[Packet], data: bytes) -> None:
    data = data[: packets[-2].offset]
    most = lost_frames_within(8)  # that of the late packet is not there yet
    for frame, fits in ((8 + most, True), (9 + most, False)):
        with follow_stream(
            io.BytesIO(data + packet_bytes(PacketKind.SKIP, frame, struct.pack("<Q", 0))), on_damage=lambda _: None
        ) as stream:
            if fits:
                assert sum(1 for _ in stream.frames()) == frame + 1
            else:
                with pytest.raises(StreamError, match="frames are missing, above the limit"):
                    list(stream.frames())
    again = packet_bytes(PacketKind.SKIP, 1, struct.pack("<Q", 0))
    _, damage = follow(data + again * MAX_DAMAGED_PLACES)
    assert len(damage) == MAX_DAMAGED_PLACES
    with pytest.raises(StreamError, match="too many places"):
        follow(data + again * (MAX_DAMAGED_PLACES + 1))


def test_without_a_listener_damage_is_a_warning(packets: list[Packet], data: bytes) -> None:
    damaged = hit(data, frame_packet(packets, 5).offset + WHERE["payload"])
    said = r"-: .* in packet 6 at byte \d+ \[bad-payload-crc\]; frames from 5 on show frame 4 until the next keyframe$"
    with follow_stream(io.BytesIO(damaged)) as stream, pytest.warns(DamageWarning, match=said) as caught:
        list(stream.frames())
    assert len(caught) == 1
