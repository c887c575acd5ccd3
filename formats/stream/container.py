"""The .dgs container: packets that delimit themselves, bounded, checksummed, append-only (SPEC.md, "Container").

This file knows packets and nothing of what is in them, except for the index and end packets, which are its own.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import IntEnum
from typing import BinaryIO, NoReturn

from ..errors import StreamError
from .cursor import Cursor
from .reasons import Reason

SIGNATURE = b"\x8bDGS\r\n\x1a\n"
"""High bit, name, CR LF, Ctrl-Z, LF: a transfer that strips bits or translates line ends breaks it, as PNG's does."""

VERSION = (1, 0)
"""Version of the bitstream (major, minor), independent of the package's version."""

LAYERED_VERSION = (1, 1)
"""That of streams with layers; writers write the lowest that suffices."""

SYNC = b"DGSP"
PROLOGUE_SIZE = 16
PACKET_HEADER_SIZE = 20
PACKET_OVERHEAD = PACKET_HEADER_SIZE + 4
MAX_PAYLOAD = 1 << 28
MAX_FRAME = (1 << 31) - 1
CRITICAL = 0x01

_PROLOGUE = struct.Struct("<8sBBH")
_PACKET_HEADER = struct.Struct("<4sBBHII")
_CRC = struct.Struct("<I")
_INDEX_ENTRY = struct.Struct("<QIB3x")
_END = struct.Struct("<IQ")
_END_PACKET_SIZE = PACKET_OVERHEAD + _END.size
_READ_CHUNK = 1 << 20
_SEARCH_CHUNK = 1 << 16

_MAX_TIMES_CHECKED = 4
"""How often, on average, each byte may be part of a packet whose checksum is wrong. Damage takes one or two; forged
packet headers inside each other would make the search for an intact one quadratic."""


class PacketKind(IntEnum):
    """What a packet holds; wire values, never renumbered."""

    HEADER = 1
    KEY = 2
    DELTA = 3
    SKIP = 4
    INDEX = 5
    END = 6
    METRICS = 7
    SOUND = 8
    REFINE = 9
    LAYERS = 10


CRITICAL_KINDS = frozenset({PacketKind.HEADER, PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP})
FRAME_KINDS = frozenset({PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP})
_KNOWN_KINDS = frozenset(int(kind) for kind in PacketKind)
_KINDS_OF_1_0 = frozenset(kind for kind in _KNOWN_KINDS if kind < PacketKind.REFINE)
"""A critical packet of any other kind is one that readers of 1.0 do not know."""


@dataclass(frozen=True)
class Packet:
    """One complete packet whose checksums were right.

    ``kind`` is a PacketKind or an unknown ancillary number; ``ordinal`` counts the packets of the stream from 0 (None
    when read at an offset); ``offset`` is the stream offset of the packet's first byte; ``start`` is where in the
    payload reading begins, behind what was read of it already.
    """

    kind: int
    frame: int
    payload: bytes
    critical: bool = True
    ordinal: int | None = None
    offset: int = 0
    start: int = 0

    @property
    def size(self) -> int:
        """Bytes on disk, overhead included."""
        return PACKET_OVERHEAD + len(self.payload)

    def cursor(self) -> Cursor:
        """A bounded reader of the payload that knows where the packet lies."""
        cursor = Cursor(self.payload, packet=self.ordinal, offset=self.offset + PACKET_HEADER_SIZE)
        cursor.take(self.start)
        return cursor


@dataclass(frozen=True, slots=True)
class IndexEntry:
    """Where the packet of one frame starts in the stream; of a refinement, ``kind`` is its layer."""

    offset: int
    frame: int
    kind: int


def prologue(version: tuple[int, int] = VERSION) -> bytes:
    """The first 16 bytes of every stream: signature, version, checksum."""
    head = _PROLOGUE.pack(SIGNATURE, *version, 0)
    return head + _CRC.pack(zlib.crc32(head))


def packet_bytes(kind: int, frame: int, payload: bytes, *, critical: bool | None = None) -> bytes:
    """One packet as it lies on disk; ``critical`` need only be given for a kind this version does not know."""
    if critical is None:
        critical = kind in CRITICAL_KINDS
    if not 0 <= frame <= MAX_FRAME:
        raise StreamError(Reason.TOO_LARGE, f"frame index {frame} is outside 0..{MAX_FRAME}")
    if len(payload) > MAX_PAYLOAD:
        raise StreamError(Reason.TOO_LARGE, f"a payload of {len(payload)} bytes is above the limit of {MAX_PAYLOAD}")
    head = _PACKET_HEADER.pack(SYNC, kind, CRITICAL if critical else 0, 0, frame, len(payload))
    return b"".join((head, _CRC.pack(zlib.crc32(head)), payload, _CRC.pack(zlib.crc32(payload))))


class StreamWriter:
    """Appends packets to any binary file object, a pipe included, and flushes after each one.

    Whatever was written before an interruption is a valid, shorter stream. ``finish`` adds the index and end packets.
    """

    def __init__(self, file: BinaryIO, header_payload: bytes, version: tuple[int, int] = VERSION) -> None:
        self._file = file
        self.bytes_written = 0
        self.entries: list[IndexEntry] = []
        self.refinements: list[IndexEntry] = []
        self._append(prologue(version) + packet_bytes(PacketKind.HEADER, 0, header_payload))

    @classmethod
    def continuing(cls, file: BinaryIO, entries: Sequence[IndexEntry], size: int) -> StreamWriter:
        """Goes on with a stream of ``size`` bytes whose frames are ``entries``; the file stands behind its last one."""
        writer = cls.__new__(cls)
        writer._file, writer.entries, writer.bytes_written, writer.refinements = file, list(entries), size, []
        return writer

    def write(self, kind: int, frame: int, payload: bytes, *, critical: bool | None = None) -> int:
        """Appends one packet and returns its size in bytes."""
        data = packet_bytes(kind, frame, payload, critical=critical)
        if kind in FRAME_KINDS:
            self.entries.append(IndexEntry(self.bytes_written, frame, kind))
        elif kind == PacketKind.REFINE:
            self.refinements.append(IndexEntry(self.bytes_written, frame, payload[0]))
        self._append(data)
        return len(data)

    def finish(self) -> None:
        """Appends the index of the frames and the end packet; the file stays open."""
        index_offset = self.bytes_written
        self.write(PacketKind.INDEX, 0, index_payload(self.entries))
        if self.refinements:
            self.write(PacketKind.LAYERS, 0, index_payload(self.refinements))
        self.write(PacketKind.END, 0, _END.pack(len(self.entries), index_offset))

    def _append(self, data: bytes) -> None:
        self._file.write(data)
        self._file.flush()
        self.bytes_written += len(data)


class PacketReader:
    """Takes packets off a stream as they become complete; needs no seeking, so it reads pipes and growing files.

    ``next`` returns None when the bytes at hand hold no further complete packet, and may be called again once the file
    has grown. ``pending`` is the number of bytes of the incomplete packet at the tail, ``ended`` whether the end packet
    was seen. A damaged packet raises StreamError; ``resynchronise`` then moves on to the next intact packet header.
    What the packets say of each other is not checked here: ``check_frame`` and ``check_count`` do that.
    """

    def __init__(self, file: BinaryIO, *, max_payload: int = MAX_PAYLOAD, offset: int = 0) -> None:
        """Starts at the file's position; ``offset`` > 0 says that a packet starts there, at that stream offset."""
        self._file = file
        self._max_payload = max_payload
        self._buffer = bytearray()
        self._offset = offset
        self._ordinal: int | None = 0 if offset == 0 else None
        self._at_prologue = offset == 0
        self._searched_from: int | None = None
        self._checked_in_vain = 0
        self.version = VERSION
        self.ended = False

    @property
    def offset(self) -> int:
        """Stream offset of the first byte that belongs to no packet returned so far."""
        return self._offset

    @property
    def ordinal(self) -> int | None:
        """Number of the next packet; None before the first, or when that is not known after reading from an offset."""
        return None if self._at_prologue else self._ordinal

    @property
    def pending(self) -> int:
        """Bytes that were read and belong to no whole packet yet; 0 while the next packet is searched for."""
        return 0 if self._searched_from is not None else len(self._buffer)

    @property
    def bytes_read(self) -> int:
        """Stream offset of the first byte that was not read yet."""
        return self._offset + len(self._buffer)

    def next(self) -> Packet | None:
        """The next complete packet, ancillary ones of unknown kind included, or None when there is none yet."""
        if self._searched_from is not None and self.resynchronise() is None:
            return None
        if self._at_prologue and not self._read_prologue():
            return None
        if self.ended:
            if self._fill(1):
                self._fail(Reason.TRAILING_DATA, "bytes follow the end packet")
            return None
        if not self._fill(PACKET_HEADER_SIZE):
            self._check_partial_sync()
            return None
        kind, critical, frame, length = self._packet_header()
        if not self._fill(PACKET_OVERHEAD + length):
            return None
        try:
            payload = self._payload(length)
        except StreamError as error:
            error.sound_of = frame if kind == PacketKind.SOUND else None
            raise
        packet = Packet(kind, frame, payload, critical, self._ordinal, self._offset)
        self._check_order(packet)
        self._consume(packet.size)
        if self._ordinal is not None:
            self._ordinal += 1
        return packet

    def resynchronise(self) -> int | None:
        """Moves past the damage to the next intact packet header; the bytes skipped.

        None when there is none yet; ``next`` then goes on with the search once the file has grown.
        """
        if self._searched_from is None:
            self._searched_from = self._offset
            self._at_prologue = False
            self._ordinal = None
            self._consume(min(1, len(self._buffer)))
        while True:
            offset = self._buffer.find(SYNC)
            self._consume(offset if offset >= 0 else max(0, len(self._buffer) - len(SYNC) + 1))
            if len(self._buffer) < PACKET_HEADER_SIZE:
                if not self._read_on():
                    return None
            elif self._header_crc_is_right():
                skipped, self._searched_from = self._offset - self._searched_from, None
                return skipped
            else:
                self._consume(1)

    def _read_prologue(self) -> bool:
        complete = self._fill(PROLOGUE_SIZE)
        _check_signature(bytes(self._buffer[: len(SIGNATURE)]))
        if not complete:
            return False
        _, major, minor, reserved = _PROLOGUE.unpack_from(self._buffer)
        (crc,) = _CRC.unpack_from(self._buffer, _PROLOGUE.size)
        if crc != zlib.crc32(bytes(self._buffer[: _PROLOGUE.size])):
            raise StreamError(Reason.BAD_HEADER_CRC, "the checksum of the first 16 bytes is wrong", offset=0)
        if major != VERSION[0]:
            message = f"bitstream version {major}.{minor} is not readable here (this reader knows {VERSION[0]}.x)"
            raise StreamError(Reason.UNSUPPORTED_VERSION, message, offset=8)
        if reserved:
            raise StreamError(Reason.RESERVED_BITS, "reserved bits are set", offset=10)
        self.version = (major, minor)
        self._at_prologue = False
        self._consume(PROLOGUE_SIZE)
        return True

    def _packet_header(self) -> tuple[int, bool, int, int]:
        sync, kind, flags, reserved, frame, length = _PACKET_HEADER.unpack_from(self._buffer)
        if sync != SYNC:
            self._fail(Reason.BAD_SYNC, "no packet starts here")
        if not self._header_crc_is_right():
            self._fail(Reason.BAD_HEADER_CRC, "the packet header's checksum is wrong")
        if flags & ~CRITICAL or reserved or frame > MAX_FRAME:
            self._fail(Reason.RESERVED_BITS, "reserved bits are set in the packet header")
        critical = bool(flags & CRITICAL)
        if kind not in _KINDS_OF_1_0:
            if critical:
                self._fail(Reason.UNKNOWN_CRITICAL, f"packet kind {kind} is unknown and must not be ignored")
        elif critical != (kind in CRITICAL_KINDS):
            self._fail(Reason.RESERVED_BITS, f"the critical bit of a {PacketKind(kind).name} packet is wrong")
        if length > self._max_payload:
            self._fail(Reason.TOO_LARGE, f"a payload of {length} bytes is above the limit of {self._max_payload}")
        return kind, critical, frame, length

    def _payload(self, length: int) -> bytes:
        """The buffered packet's payload; raises when its checksum is wrong."""
        end = PACKET_HEADER_SIZE + length
        (crc,) = _CRC.unpack_from(self._buffer, end)
        with memoryview(self._buffer) as buffered, buffered[PACKET_HEADER_SIZE:end] as payload:
            if crc == zlib.crc32(payload):
                return bytes(payload)
        self._checked_in_vain += length
        if self._checked_in_vain > _READ_CHUNK + _MAX_TIMES_CHECKED * (self._offset + len(self._buffer)):
            self._fail(Reason.TOO_LARGE, "too many damaged packets overlap")
        self._fail(Reason.BAD_PAYLOAD_CRC, "the payload's checksum is wrong")

    def _header_crc_is_right(self) -> bool:
        (crc,) = _CRC.unpack_from(self._buffer, _PACKET_HEADER.size)
        return bool(crc == zlib.crc32(bytes(self._buffer[: _PACKET_HEADER.size])))

    def _check_order(self, packet: Packet) -> None:
        """The header comes first and once; the end packet is well-formed."""
        if (packet.kind == PacketKind.HEADER) != (packet.offset == PROLOGUE_SIZE):
            self._fail(Reason.MISPLACED_PACKET, "a stream has one header packet, which comes first")
        if packet.kind == PacketKind.END:
            end_fields(packet)
            self.ended = True

    def _check_partial_sync(self) -> None:
        """Bytes at the tail that cannot grow into a packet are damage, not a packet under way."""
        head = bytes(self._buffer[: len(SYNC)])
        if head != SYNC[: len(head)]:
            self._fail(Reason.BAD_SYNC, "no packet starts here")

    def _fill(self, size: int) -> bool:
        """Reads on until ``size`` bytes are buffered; in bounded chunks, so that a lying length allocates nothing."""
        while len(self._buffer) < size:
            chunk = self._file.read(min(size - len(self._buffer), _READ_CHUNK))
            if not chunk:
                return False
            self._buffer += chunk
        return True

    def _read_on(self) -> bool:
        """Buffers some more bytes, whatever is there at once in a pipe; whether there were any."""
        chunk: bytes = getattr(self._file, "read1", self._file.read)(_SEARCH_CHUNK)
        self._buffer += chunk
        return bool(chunk)

    def _consume(self, size: int) -> None:
        del self._buffer[:size]
        self._offset += size

    def _fail(self, reason: str, message: str) -> NoReturn:
        raise StreamError(reason, message, packet=self._ordinal, offset=self._offset)


def stops_inside(size: int, offset: int, packet: int | None = None) -> StreamError:
    """What is wrong with a stream that ends ``size`` bytes into the packet at ``offset``."""
    message = f"the stream stops {size} bytes into a packet"
    return StreamError(Reason.TRUNCATED, message, packet=packet, offset=offset)


def check_frame(packet: Packet, expected: int) -> None:
    """Frames count 0, 1, 2, ... in a stream that is read in order; raises StreamError("frame-order") when not."""
    if packet.frame != expected:
        message = f"frame {packet.frame} where frame {expected} must come"
        raise StreamError(Reason.FRAME_ORDER, message, packet=packet.ordinal, offset=packet.offset)


def check_count(end: Packet, frames: int) -> None:
    """The end packet counts the frames before it; raises StreamError("index-mismatch") when it does not."""
    declared, _ = end_fields(end)
    if declared != frames:
        message = f"the end packet counts {declared} frames, {frames} came"
        raise StreamError(Reason.INDEX_MISMATCH, message, packet=end.ordinal, offset=end.offset)


def read_packet_at(file: BinaryIO, entry: IndexEntry, *, max_payload: int = MAX_PAYLOAD) -> Packet:
    """The packet an index entry points at; raises StreamError("index-mismatch") when another one lies there."""
    file.seek(entry.offset)
    reader = PacketReader(file, max_payload=max_payload, offset=entry.offset)
    packet = reader.next()
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops inside a packet", offset=entry.offset)
    if (packet.kind, packet.frame) != (entry.kind, entry.frame):
        raise StreamError(Reason.INDEX_MISMATCH, "the index points at another packet", offset=entry.offset)
    return packet


def index_payload(entries: list[IndexEntry]) -> bytes:
    """Payload of an index packet, or of one of layers: count, then offset, frame and kind or layer of each packet."""
    rows = [_INDEX_ENTRY.pack(entry.offset, entry.frame, entry.kind) for entry in entries]
    return _CRC.pack(len(rows)) + b"".join(rows)


def parse_index(packet: Packet, *, max_frames: int = MAX_FRAME) -> list[IndexEntry]:
    """The entries of an index packet; raises StreamError when it is malformed."""
    cursor = packet.cursor()
    count = cursor.u32()
    if count * _INDEX_ENTRY.size != cursor.remaining:
        cursor.fail(Reason.BAD_PAYLOAD, f"{count} index entries do not fill the {cursor.remaining} bytes left")
    if count > max_frames:
        cursor.fail(Reason.TOO_LARGE, f"{count} frames are above the limit of {max_frames}")
    entries = [IndexEntry(*fields) for fields in _INDEX_ENTRY.iter_unpack(cursor.take(cursor.remaining))]
    ends = [*(entry.offset for entry in entries[1:]), packet.offset]
    if any(entry.offset + PACKET_OVERHEAD > end for entry, end in zip(entries, ends, strict=True)):
        cursor.fail(Reason.INDEX_MISMATCH, "the index is not in stream order")
    if any(entry.kind not in FRAME_KINDS for entry in entries):
        cursor.fail(Reason.INDEX_MISMATCH, "the index lists a packet that is no frame")
    return entries


def read_index(
    file: BinaryIO, *, max_payload: int = MAX_PAYLOAD, max_frames: int = MAX_FRAME
) -> list[IndexEntry] | None:
    """The index at the end of a seekable file, None when there is none that can be used; reads the tail only.

    Raises StreamError("too-large") above a limit.
    """
    size = file.seek(0, os.SEEK_END)
    if size < PROLOGUE_SIZE + _END_PACKET_SIZE:
        return None
    try:
        end = read_packet_at(file, IndexEntry(size - _END_PACKET_SIZE, 0, PacketKind.END))
        frames, offset = end_fields(end)
        if not PROLOGUE_SIZE <= offset < end.offset:
            return None
        packet = read_packet_at(file, IndexEntry(offset, 0, PacketKind.INDEX), max_payload=max_payload)
        entries = parse_index(packet, max_frames=max_frames)
    except StreamError as error:
        if error.reason == Reason.TOO_LARGE:
            raise
        return None
    in_order = [entry.frame for entry in entries] == list(range(frames)) if frames == len(entries) else False
    return entries if in_order else None


def scan_index(file: BinaryIO, *, max_frames: int = MAX_FRAME) -> list[IndexEntry]:
    """The same entries from the packet headers of a seekable file, without reading the payloads.

    Stops at an incomplete tail; raises StreamError at a damaged packet header and above ``max_frames``.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = file.read(PROLOGUE_SIZE)
    _check_signature(head[: len(SIGNATURE)])
    offset, ordinal, entries = PROLOGUE_SIZE, 0, []
    while offset + PACKET_OVERHEAD <= size:
        kind, frame, length = _header_at(file, offset, ordinal)
        if offset + PACKET_OVERHEAD + length > size:
            break
        if kind in FRAME_KINDS:
            entries.append(IndexEntry(offset, frame, kind))
            if len(entries) > max_frames:
                raise StreamError(Reason.TOO_LARGE, f"more frames than the limit of {max_frames}", offset=offset)
        offset += PACKET_OVERHEAD + length
        ordinal += 1
    return entries


def refinements_between(file: BinaryIO, start: int, stop: int | None) -> list[IndexEntry]:
    """Where the REFINE packets of a seekable file lie from the packet at ``start`` up to the next frame's, or ``stop``.

    Payloads are not read, but for the layer. Stops at an incomplete tail; raises StreamError at damage.
    """
    size, offset, entries = file.seek(0, os.SEEK_END), start, list[IndexEntry]()
    stop = size if stop is None else min(stop, size)
    while offset + PACKET_OVERHEAD <= stop:
        kind, frame, length = _header_at(file, offset)
        if kind in FRAME_KINDS or offset + PACKET_OVERHEAD + length > stop:
            break
        if kind == PacketKind.REFINE and length:
            entries.append(IndexEntry(offset, frame, file.read(1)[0]))
        offset += PACKET_OVERHEAD + length
    return entries


def unknown_kinds(file: BinaryIO) -> list[int]:
    """Kinds of packets in a seekable file that this version does not know, rising; found up to the first damage."""
    size, offset, kinds = file.seek(0, os.SEEK_END), PROLOGUE_SIZE, set()
    with suppress(StreamError):
        while offset + PACKET_OVERHEAD <= size:
            kind, _, length = _header_at(file, offset)
            offset += PACKET_OVERHEAD + length
            kinds.add(kind)
    return sorted(kinds - _KNOWN_KINDS)


def end_of_packet(file: BinaryIO, offset: int) -> int:
    """Where the packet at this offset of a seekable file ends; its payload is not read. Raises StreamError."""
    return offset + PACKET_OVERHEAD + _header_at(file, offset)[2]


def _header_at(file: BinaryIO, offset: int, ordinal: int | None = None) -> tuple[int, int, int]:
    """Kind, frame and length of the payload, as the packet's header says; raises StreamError where there is none."""
    file.seek(offset)
    head = file.read(PACKET_HEADER_SIZE)
    if len(head) < PACKET_HEADER_SIZE:
        raise StreamError(Reason.TRUNCATED, "the stream stops inside a packet", packet=ordinal, offset=offset)
    sync, kind, _, _, frame, length = _PACKET_HEADER.unpack_from(head)
    if sync != SYNC:
        raise StreamError(Reason.BAD_SYNC, "no packet starts here", packet=ordinal, offset=offset)
    if _CRC.unpack_from(head, _PACKET_HEADER.size)[0] != zlib.crc32(head[: _PACKET_HEADER.size]):
        message = "the packet header's checksum is wrong"
        raise StreamError(Reason.BAD_HEADER_CRC, message, packet=ordinal, offset=offset)
    return kind, frame, length


def end_fields(packet: Packet) -> tuple[int, int]:
    """Number of frames and offset of the index packet (0 for none) in an end packet; raises StreamError."""
    cursor = packet.cursor()
    if cursor.remaining != _END.size:
        cursor.fail(Reason.BAD_PAYLOAD, f"an end packet has {_END.size} bytes, not {cursor.remaining}")
    frames, offset = _END.unpack(cursor.take(_END.size))
    return frames, offset


def _check_signature(head: bytes) -> None:
    """Raises when these first bytes cannot be those of a .dgs stream."""
    if head == SIGNATURE[: len(head)]:
        return
    damaged = (SIGNATURE.replace(b"\r\n", b"\n"), SIGNATURE.replace(b"\n", b"\r\n"), bytes(b & 127 for b in SIGNATURE))
    if len(head) >= 6 and any(variant[: len(head)] == head[: len(variant)] for variant in damaged):
        raise StreamError(Reason.TEXT_DAMAGE, "the file was transferred as text; transfer it again as binary", offset=0)
    raise StreamError(Reason.BAD_SIGNATURE, "this is not a .dgs stream", offset=0)
