"""All packets of a stream in order, as strictly as they can be read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

from decogs.formats.container import (
    FRAME_KINDS,
    MAX_PAYLOAD,
    Packet,
    PacketKind,
    PacketReader,
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
