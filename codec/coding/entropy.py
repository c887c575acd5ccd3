"""Coded blocks: bytes stored as they are or as one zstd frame, whichever is smaller (SPEC.md, "Coded block")."""

from __future__ import annotations

import struct
import threading

import zstandard

from decogs.formats.stream.cursor import Cursor
from decogs.formats.stream.reasons import Reason

STORED, ZSTD = 0, 1
DEFAULT_LEVEL = 15
"""zstd's; on byte planes 19 is no smaller and takes twice the time (DESIGN.md)."""

WINDOW_LOG = 23
MAX_WINDOW = 1 << WINDOW_LOG

_BLOCK_HEADER = struct.Struct("<BI")
BLOCK_HEADER_SIZE = _BLOCK_HEADER.size


class _PerThread(threading.local):
    """Threads must not share a decompressor, and making one takes longer than reading a small block."""

    def __init__(self) -> None:
        self.decompressor = zstandard.ZstdDecompressor()


_PER_THREAD = _PerThread()


def coded_block(raw: bytes, level: int = DEFAULT_LEVEL) -> bytes:
    """Codec id, length, data. ``level`` is zstd's: 3 for live work."""
    codec, data = STORED, raw
    if raw:
        compressed = _compressor(level, len(raw)).compress(raw)
        if len(compressed) < len(raw):
            codec, data = ZSTD, compressed
    return _BLOCK_HEADER.pack(codec, len(data)) + data


def read_block(cursor: Cursor, low: int, high: int) -> bytes:
    """The bytes of the next coded block, which must number ``low`` to ``high``.

    The declared sizes are checked before anything is allocated. Raises StreamError "bad-payload", "bad-compression" or,
    for a codec id of a later version, "unsupported-mode".
    """
    codec, length = _BLOCK_HEADER.unpack(cursor.take(BLOCK_HEADER_SIZE))
    if codec not in (STORED, ZSTD):
        cursor.fail(Reason.UNSUPPORTED_MODE, f"codec id {codec} is unknown")
    data = cursor.take(length)
    if codec == ZSTD:
        return _decompress(cursor, data, low, high)
    if not low <= length <= high:
        cursor.fail(Reason.BAD_PAYLOAD, f"a block has {length} bytes, not {low} to {high}")
    return bytes(data)


def skip_block(cursor: Cursor) -> None:
    """Passes over the next coded block by its declared length."""
    _, length = _BLOCK_HEADER.unpack(cursor.take(BLOCK_HEADER_SIZE))
    cursor.take(length)


def _compressor(level: int, size: int) -> zstandard.ZstdCompressor:
    parameters = zstandard.ZstdCompressionParameters.from_level(level, source_size=size)
    if parameters.window_log > WINDOW_LOG:
        parameters = zstandard.ZstdCompressionParameters.from_level(level, source_size=size, window_log=WINDOW_LOG)
    return zstandard.ZstdCompressor(compression_params=parameters)


def _decompress(cursor: Cursor, data: memoryview, low: int, high: int) -> bytes:
    try:
        frame = zstandard.get_frame_parameters(data)
    except zstandard.ZstdError:
        cursor.fail(Reason.BAD_COMPRESSION, "a compressed block does not start as a zstd frame")
    # Nothing is never compressed; a size of 0 would also let frames pass that zstandard then does not look into.
    if not max(low, 1) <= frame.content_size <= high:
        cursor.fail(Reason.BAD_COMPRESSION, f"a zstd frame declares {frame.content_size} bytes, not {low} to {high}")
    if frame.window_size > MAX_WINDOW or frame.dict_id:
        cursor.fail(Reason.BAD_COMPRESSION, "a zstd frame needs a window above 8 MiB or a dictionary")
    try:
        size = frame.content_size
        raw = _PER_THREAD.decompressor.decompress(data, max_output_size=size, allow_extra_data=False)
    except zstandard.ZstdError:
        cursor.fail(Reason.BAD_COMPRESSION, "a zstd frame is damaged")
    if len(raw) != frame.content_size:
        cursor.fail(Reason.BAD_COMPRESSION, "a zstd frame holds another number of bytes than it declares")
    return raw
