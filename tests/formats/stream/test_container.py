"""Packets on the wire: round trips, truncation and damage at every byte, growing files, the index."""

from __future__ import annotations

import io
import os
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import (
    PACKET_HEADER_SIZE,
    PACKET_OVERHEAD,
    PROLOGUE_SIZE,
    SIGNATURE,
    IndexEntry,
    PacketKind,
    PacketReader,
    StreamWriter,
    index_payload,
    packet_bytes,
    prologue,
    read_index,
    read_packet_at,
    scan_index,
)
from decogs.formats.stream.reasons import ALL_REASONS
from packets import iterate_packets

FRAMES = [
    (PacketKind.KEY, b"keyframe"),
    (PacketKind.DELTA, b"d" * 40),
    (PacketKind.SKIP, b""),
    (PacketKind.DELTA, b"DGSP"),
]


def stream(frames=FRAMES, *, finish: bool = True) -> bytes:
    file = io.BytesIO()
    writer = StreamWriter(file, b"header")
    for frame, (kind, payload) in enumerate(frames):
        writer.write(kind, frame, payload)
    if finish:
        writer.finish()
    assert writer.bytes_written == len(file.getvalue())
    return file.getvalue()


def packets(data: bytes, **options) -> list:
    return list(iterate_packets(io.BytesIO(data), **options))


def reason_of(data: bytes, **options) -> str:
    with pytest.raises(StreamError) as caught:
        packets(data, **options)
    assert caught.value.reason in ALL_REASONS
    return caught.value.reason


@given(
    st.lists(st.tuples(st.sampled_from([PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP]), st.binary(max_size=99)))
)
def test_packets_come_back_in_order_with_their_offsets(frames) -> None:
    data = stream(frames)
    found = packets(data)
    assert [(p.kind, p.payload) for p in found[1:-2]] == frames
    assert [p.frame for p in found[1:-2]] == list(range(len(frames)))
    assert [p.ordinal for p in found] == list(range(len(frames) + 3))
    assert found[0].offset == PROLOGUE_SIZE
    for packet in found:
        assert data[packet.offset : packet.offset + packet.size] == packet_bytes(
            packet.kind, packet.frame, packet.payload
        )


def test_a_stream_needs_neither_index_nor_end() -> None:
    assert [p.payload for p in packets(stream(finish=False))[1:]] == [payload for _, payload in FRAMES]


def test_truncation_at_every_byte_leaves_every_complete_packet() -> None:
    data, whole = stream(), packets(stream())
    ends = [packet.offset + packet.size for packet in whole]
    for size in range(len(data)):
        complete = sum(end <= size for end in ends)
        assert packets(data[:size], strict=False) == whole[:complete]
        if size in ends:
            assert packets(data[:size]) == whole[:complete]
        else:
            assert reason_of(data[:size]) == "truncated"


def test_a_flipped_bit_anywhere_is_an_error_after_a_correct_prefix() -> None:
    data, whole = stream(), packets(stream())
    for position in range(len(data)):
        for bit in range(8):
            damaged = bytearray(data)
            damaged[position] ^= 1 << bit
            found = []
            with pytest.raises(StreamError) as caught:
                found.extend(packet for packet in iterate_packets(io.BytesIO(bytes(damaged))))
            assert caught.value.reason in ALL_REASONS
            assert caught.value.offset is not None
            assert found == whole[: len(found)]


@given(st.binary(max_size=300), st.booleans())
def test_arbitrary_bytes_raise_stream_errors_only(data: bytes, signed: bool) -> None:
    with pytest.raises(StreamError):
        packets((prologue() if signed else b"") + data + b"?")


def test_text_mode_damage_is_named() -> None:
    data = stream()
    assert reason_of(data.replace(b"\r\n", b"\n")) == "text-damage"
    assert reason_of(data.replace(b"\n", b"\r\n")) == "text-damage"
    assert reason_of(bytes(byte & 127 for byte in data)) == "text-damage"
    assert reason_of(b"ply\nformat binary") == "bad-signature"
    assert reason_of(b"") == "truncated"


def test_versions() -> None:
    rest = stream()[PROLOGUE_SIZE:]
    assert len(packets(prologue((1, 9)) + rest)) == 7
    assert reason_of(prologue((2, 0)) + rest) == "unsupported-version"


def test_unknown_ancillary_packets_are_skipped_and_unknown_critical_ones_refused() -> None:
    data = stream(finish=False)
    assert packets(data + packet_bytes(99, 0, b"later")) == packets(data)
    assert packets(data + packet_bytes(PacketKind.METRICS, 3, b"{}"))[-1].payload == b"{}"
    assert reason_of(data + packet_bytes(99, 0, b"later", critical=True)) == "unknown-critical"


def raw_packet(kind=3, flags=1, reserved=0, frame=0, payload=b"") -> bytes:
    head = struct.pack("<4sBBHII", b"DGSP", kind, flags, reserved, frame, len(payload))
    return head + struct.pack("<I", zlib.crc32(head)) + payload + struct.pack("<I", zlib.crc32(payload))


@pytest.mark.parametrize(
    "fields", [{"flags": 3}, {"flags": 0}, {"reserved": 1}, {"frame": 1 << 31}, {"kind": 5}, {"kind": 2, "flags": 128}]
)
def test_reserved_bits_and_wrong_critical_bits_are_refused(fields) -> None:
    assert reason_of(stream(finish=False) + raw_packet(**fields)) == "reserved-bits"


def test_header_must_come_first_and_once() -> None:
    header = packet_bytes(PacketKind.HEADER, 0, b"h")
    assert reason_of(prologue() + packet_bytes(PacketKind.KEY, 0, b"k") + header) == "misplaced-packet"
    assert reason_of(stream(finish=False) + header) == "misplaced-packet"


def test_nothing_may_follow_the_end_and_the_end_counts_the_frames() -> None:
    assert reason_of(stream() + b"\0") == "trailing-data"
    end = struct.pack("<IQ", 9, 0)
    assert reason_of(stream(finish=False) + packet_bytes(PacketKind.END, 0, end)) == "index-mismatch"
    assert reason_of(stream(finish=False) + packet_bytes(PacketKind.END, 0, b"short")) == "bad-payload"


class CountingFile(io.BytesIO):
    """Remembers the largest read that was asked for and the bytes handed out."""

    largest = 0
    handed_out = 0

    def read(self, size: int | None = -1) -> bytes:
        self.largest = max(self.largest, size)
        data = super().read(size)
        self.handed_out += len(data)
        return data


def test_a_lying_length_allocates_nothing() -> None:
    head = struct.pack("<4sBBHII", b"DGSP", 2, 1, 0, 0, 1 << 28)
    file = CountingFile(stream(finish=False) + head + struct.pack("<I", zlib.crc32(head)) + b"x" * 100)
    with pytest.raises(StreamError, match="truncated"):
        list(iterate_packets(file))
    assert file.largest <= 1 << 20
    assert reason_of(file.getvalue(), max_payload=1000) == "too-large"


def append(file: io.BytesIO, data: bytes) -> None:
    """The file grows while a reader stands somewhere in it."""
    here = file.tell()
    file.seek(0, os.SEEK_END)
    file.write(data)
    file.seek(here)


def test_a_growing_file_gives_each_packet_as_it_completes() -> None:
    data, whole = stream(), packets(stream())
    file = io.BytesIO()
    reader = PacketReader(file)
    found = []
    for position in range(len(data)):
        append(file, data[position : position + 1])
        if (packet := reader.next()) is not None:
            assert packet.offset + packet.size == position + 1
            found.append(packet)
    assert found == whole
    assert reader.ended
    assert reader.next() is None


def test_a_pipe_can_be_read_and_written() -> None:
    read_end, write_end = os.pipe()
    with os.fdopen(write_end, "wb") as out:
        writer = StreamWriter(out, b"header")
        writer.write(PacketKind.KEY, 0, b"k" * 5000)
        writer.finish()
    with os.fdopen(read_end, "rb") as source:
        assert [p.kind for p in iterate_packets(source)] == [1, 2, 5, 6]


def test_each_packet_is_flushed_when_it_is_written() -> None:
    class Unflushed(io.BytesIO):
        visible = b""

        def flush(self) -> None:
            self.visible = self.getvalue()

    file = Unflushed()
    writer = StreamWriter(file, b"header")
    for frame, (kind, payload) in enumerate(FRAMES):
        writer.write(kind, frame, payload)
        assert packets(file.visible)[-1].payload == payload


@pytest.mark.parametrize("where", ["sync", "header", "payload"])
def test_reading_resumes_after_a_damaged_packet(where: str) -> None:
    data, whole = bytearray(stream()), packets(stream())
    victim = whole[2]
    data[victim.offset + {"sync": 0, "header": 9, "payload": 25}[where]] ^= 4
    reader = PacketReader(io.BytesIO(bytes(data)))
    assert [reader.next(), reader.next()] == whole[:2]
    with pytest.raises(StreamError):
        reader.next()
    assert reader.resynchronise() == victim.size
    rest = []
    while (packet := reader.next()) is not None:
        rest.append((packet.kind, packet.frame, packet.payload, packet.offset))
    assert rest == [(p.kind, p.frame, p.payload, p.offset) for p in whole[3:]]
    assert reader.ended


def test_resynchronising_at_the_tail_finds_nothing() -> None:
    reader = PacketReader(io.BytesIO(stream(finish=False) + b"DGSQ" + b"DGS" * 30))
    for _ in range(5):
        reader.next()
    with pytest.raises(StreamError):
        reader.next()
    assert reader.resynchronise() is None


def test_a_search_goes_on_where_it_stopped_when_the_file_grows() -> None:
    """Byte by byte: what stands at the end may be part of a packet header, and must not be lost to the search."""
    data, whole = bytearray(stream()), packets(stream())
    data[whole[2].offset + 25] ^= 4
    file = io.BytesIO(data[: whole[3].offset])
    reader = PacketReader(file)
    assert [reader.next(), reader.next()] == whole[:2]
    with pytest.raises(StreamError):
        reader.next()
    assert reader.resynchronise() is None
    found = []
    for position in range(whole[3].offset, len(data)):
        append(file, bytes(data[position : position + 1]))
        if (packet := reader.next()) is not None:
            found.append((packet.kind, packet.frame, packet.offset, position + 1))
        assert reader.bytes_read <= position + 1
        if position + 1 < whole[3].offset + PACKET_HEADER_SIZE:
            assert reader.pending == 0, "what is searched is no packet under way"
    assert found == [(p.kind, p.frame, p.offset, p.offset + p.size) for p in whole[3:]]
    assert reader.ended


def test_index_and_scan_agree_and_lead_to_the_frames() -> None:
    data = stream()
    entries = read_index(io.BytesIO(data))
    assert entries == scan_index(io.BytesIO(stream(finish=False)))
    assert [read_packet_at(io.BytesIO(data), entry).payload for entry in entries] == [payload for _, payload in FRAMES]


def test_index_reads_the_tail_only_and_scan_the_packet_headers_only() -> None:
    frames = [(PacketKind.DELTA, bytes(50_000))] * 20
    for finish, read in ((True, read_index), (False, scan_index)):
        file = CountingFile(stream(frames, finish=finish))
        assert len(read(file)) == 20
        assert file.handed_out < 2000


def test_scan_stops_at_an_incomplete_tail() -> None:
    data = stream(finish=False)
    assert len(scan_index(io.BytesIO(data[:-1]))) == 3
    assert len(scan_index(io.BytesIO(data + b"DGSP\3"))) == 4
    assert len(scan_index(io.BytesIO(stream([*FRAMES, (PacketKind.SKIP, b"")], finish=False)))) == 5


def with_index(entries: list[IndexEntry]) -> bytes:
    data = stream(finish=False)
    index = packet_bytes(PacketKind.INDEX, 0, index_payload(entries))
    end = packet_bytes(PacketKind.END, 0, struct.pack("<IQ", len(entries), len(data)))
    return data + index + end


def test_an_index_that_lies_is_not_believed() -> None:
    true = scan_index(io.BytesIO(stream()))
    assert read_index(io.BytesIO(with_index(true))) == true
    assert read_index(io.BytesIO(with_index(true[::-1]))) is None
    assert read_index(io.BytesIO(with_index([IndexEntry(1 << 60, 0, 2)]))) is None
    assert read_index(io.BytesIO(with_index([IndexEntry(true[0].offset, 0, 1)]))) is None
    shifted = [IndexEntry(true[0].offset, 5, 2)]
    data = io.BytesIO(with_index(shifted))
    assert read_index(data) is None
    with pytest.raises(StreamError, match="index-mismatch"):
        read_packet_at(data, shifted[0])
    with pytest.raises(StreamError, match="bad-sync"):
        read_packet_at(data, IndexEntry(PROLOGUE_SIZE + 1, 0, 2))


def test_a_damaged_index_is_none_and_the_scan_does_without_it() -> None:
    data = bytearray(stream())
    data[-40] ^= 1
    assert read_index(io.BytesIO(bytes(data))) is None
    assert len(scan_index(io.BytesIO(bytes(data)))) == 4


def test_sizes_of_the_specification() -> None:
    assert len(prologue()) == PROLOGUE_SIZE == 16
    assert len(packet_bytes(PacketKind.SKIP, 0, b"12345678")) == PACKET_OVERHEAD + 8 == 32
    assert SIGNATURE.hex() == "8b4447530d0a1a0a"


def test_frames_and_payloads_out_of_bounds_are_not_written() -> None:
    with pytest.raises(StreamError, match="too-large"):
        packet_bytes(PacketKind.SKIP, 1 << 31, b"")
