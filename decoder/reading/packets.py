"""Access to the packets of a stream's frames: each by its place, one after the other where they follow each other."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any, BinaryIO

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import FRAME_KINDS, IndexEntry, Packet, PacketReader
from decogs.formats.stream.reasons import Reason
from decogs.formats.stream.survey import Survey
from decogs.formats.system.operating_systems import read_at

WRONG_INDEX = frozenset(
    {Reason.INDEX_MISMATCH, Reason.BAD_SYNC, Reason.BAD_HEADER_CRC, Reason.TRUNCATED, Reason.MISPLACED_PACKET}
)
"""What is found where an index that is wrong says that a frame lies."""


class FramePackets:
    """The packets of frames in rising order, read one after the other as long as none is damaged or passed over."""

    def __init__(
        self,
        survey: Callable[[], Survey],
        reader_at: Callable[[int], PacketReader],
        pass_over: Callable[[StreamError], None],
    ) -> None:
        self._survey, self._reader_at, self._pass_over = survey, reader_at, pass_over
        self._reader: PacketReader | None = None
        self._last: int | None = None

    def of(self, frame: int) -> Packet:
        """The packet of a frame; raises StreamError when it is lost or damaged."""
        survey = self._survey()
        entry = survey.entry(frame)
        reader, self._reader = self._reader, None
        if entry is None:
            raise survey.cause(frame)
        if reader is None or self._last != frame - 1:
            # From the very start when no frame is passed over: errors can then count packets.
            reader = self._reader_at(0 if entry == survey.entries[0] else entry.offset)
        try:
            packet = _next_frame(reader, entry)
        except StreamError as error:
            if reader.offset >= entry.offset:
                raise
            self._pass_over(error)
            reader = self._reader_at(entry.offset)
            packet = _next_frame(reader, entry)
        self._reader, self._last = reader, frame
        return packet


class FileFrom(io.RawIOBase):
    """A file read from a place of its own, so that several readers can share one open file."""

    def __init__(self, file: BinaryIO, offset: int) -> None:
        self._file, self._offset = file, offset

    def readable(self) -> bool:
        """Always: it is only read."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Reads on from its own place into ``buffer``; returns how many bytes, 0 at the end."""
        # The file is asked for its descriptor each time: once closed it has none, and the number is another file's.
        data = read_at(self._file.fileno(), len(buffer), self._offset)
        buffer[: len(data)] = data
        self._offset += len(data)
        return len(data)


def _next_frame(reader: PacketReader, entry: IndexEntry) -> Packet:
    while (packet := reader.next()) is not None and packet.kind not in FRAME_KINDS:
        pass
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops inside a packet", offset=reader.offset)
    if (packet.offset, packet.kind, packet.frame) != (entry.offset, entry.kind, entry.frame):
        message = f"the index says that frame {entry.frame} lies elsewhere"
        raise StreamError(Reason.INDEX_MISMATCH, message, packet=packet.ordinal, offset=packet.offset)
    return packet
