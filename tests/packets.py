"""All packets of a stream in order, as strictly as they can be read, and a stream with another header."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.formats.stream.container import (
    FRAME_KINDS,
    MAX_PAYLOAD,
    Packet,
    PacketKind,
    PacketReader,
    StreamWriter,
    check_count,
    check_frame,
    stops_inside,
)


def iterate_packets(file: BinaryIO, *, strict: bool = True, max_payload: int = MAX_PAYLOAD) -> Iterator[Packet]:
    """Every complete packet from the start of a stream; ancillary packets of unknown kind are skipped.

    An incomplete packet at the tail raises StreamError("truncated") after the complete ones when ``strict``, else the
    iteration just ends. Damage always raises.
    """
    reader, frame = PacketReader(file, max_payload=max_payload), 0
    while (packet := reader.next()) is not None:
        if packet.kind in FRAME_KINDS:
            check_frame(packet, frame)
            frame += 1
        elif packet.kind == PacketKind.END:
            check_count(packet, frame)
        if packet.kind in tuple(PacketKind):
            yield packet
    if strict and (reader.pending or not reader.ordinal):
        raise stops_inside(reader.pending, reader.offset, reader.ordinal)


def with_header(stream: Path, other: Path, **changes: Any) -> Path:
    """Writes ``other``: the finished stream whose header has other values of these fields."""
    with stream.open("rb") as source, other.open("wb") as file:
        head, *packets = iterate_packets(source)
        writer = StreamWriter(file, replace(StreamHeader.from_bytes(head.payload), **changes).to_bytes())
        for packet in packets:
            if packet.kind not in (PacketKind.INDEX, PacketKind.END):
                writer.write(packet.kind, packet.frame, packet.payload)
        writer.finish()
    return other
