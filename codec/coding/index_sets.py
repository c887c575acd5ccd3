"""Index sets: which rows of the state a delta touches or removes (SPEC.md, "Index set")."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from decogs.formats.stream.cursor import Cursor
from decogs.formats.stream.reasons import Reason

from ..scene.state import Rows
from .entropy import coded_block, read_block, skip_block

EMPTY, ALL, BITMAP, GAPS = 0, 1, 2, 3
_MAX_VARINT = 5
_COUNT = struct.Struct("<I")


def write_index_set(rows: Rows, population: int, level: int) -> bytes:
    """The strictly increasing ``rows`` out of ``population``: bitmap or gaps, whichever is smaller."""
    if not len(rows):
        return bytes([EMPTY])
    if len(rows) == population:
        return bytes([ALL])
    members = np.zeros(population, np.uint8)
    members[rows] = 1
    bitmap = bytes([BITMAP]) + coded_block(np.packbits(members, bitorder="little").tobytes(), level)
    gaps = np.diff(rows, prepend=-1).astype(np.uint64) - np.uint64(1)
    listed = bytes([GAPS]) + _COUNT.pack(len(rows)) + coded_block(write_varints(gaps), level)
    return min(bitmap, listed, key=len)


def read_index_set(cursor: Cursor, population: int) -> Rows:
    """The rows, (n,) int64, strictly increasing and below ``population``; raises StreamError("bad-index-set")."""
    tag = cursor.u8()
    if tag == EMPTY:
        return np.zeros(0, np.int64)
    if tag == ALL:
        return np.arange(population, dtype=np.int64)
    if tag == BITMAP:
        return _read_bitmap(cursor, population)
    if tag == GAPS:
        return _read_gaps(cursor, population)
    return cursor.fail(Reason.UNSUPPORTED_MODE, f"index set tag {tag} is unknown")


def skip_index_set(cursor: Cursor, population: int | None = None) -> bool:
    """Passes over an index set; whether it holds a row of the ``population``.

    Without that only "empty" is taken to hold none, as in all that ``write_index_set`` writes; with it a bitmap is
    decoded.
    """
    tag = cursor.u8()
    if tag == ALL:
        return population != 0
    if tag == BITMAP and population is not None:
        return len(_read_bitmap(cursor, population)) > 0
    if tag == GAPS:
        cursor.u32()
    if tag in (BITMAP, GAPS):
        skip_block(cursor)
    return tag != EMPTY


def write_varints(values: NDArray[np.uint64]) -> bytes:
    """Unsigned numbers below 2**35 as LEB128: seven bits a byte, lowest first, high bit set on all but the last."""
    lengths = np.ones(len(values), np.int64)
    for k in range(1, _MAX_VARINT):
        lengths += values >= np.uint64(1 << (7 * k))
    starts = np.cumsum(lengths) - lengths
    data = np.zeros(int(lengths.sum()), np.uint8)
    for k in range(int(lengths.max(initial=0))):
        has = lengths > k
        more = np.where(lengths[has] > k + 1, np.uint8(128), np.uint8(0))
        data[starts[has] + k] = ((values[has] >> np.uint64(7 * k)) & np.uint64(127)).astype(np.uint8) | more
    return data.tobytes()


def read_varints(cursor: Cursor, raw: bytes, count: int) -> NDArray[np.uint64]:
    """Exactly ``count`` numbers in their shortest form; raises StreamError("bad-index-set") otherwise."""
    data = np.frombuffer(raw, np.uint8)
    if len(data) == count and data.max(initial=0) < 128:
        return data.astype(np.uint64)
    ends = np.nonzero(data < 128)[0]
    if len(ends) != count or (count and ends[-1] != len(data) - 1):
        cursor.fail(Reason.BAD_INDEX_SET, f"{len(data)} bytes do not hold {count} numbers")
    starts = np.concatenate([np.zeros(1, np.int64), ends[:-1] + 1])[:count]
    lengths = ends - starts + 1
    if lengths.max(initial=1) > _MAX_VARINT or (data[ends[lengths > 1]] == 0).any():
        cursor.fail(Reason.BAD_INDEX_SET, "a number is not in its shortest form")
    values = np.zeros(count, np.uint64)
    for k in range(int(lengths.max(initial=0))):
        has = lengths > k
        values[has] |= (data[starts[has] + k] & np.uint8(127)).astype(np.uint64) << np.uint64(7 * k)
    return values


def _read_bitmap(cursor: Cursor, population: int) -> Rows:
    size = (population + 7) // 8
    bits = np.unpackbits(np.frombuffer(read_block(cursor, size, size), np.uint8), bitorder="little")
    if bits[population:].any():
        cursor.fail(Reason.BAD_INDEX_SET, "a bitmap has bits beyond the last row")
    return np.nonzero(bits)[0].astype(np.int64, copy=False)


def _read_gaps(cursor: Cursor, population: int) -> Rows:
    count = cursor.u32()
    if not 0 < count <= population:
        cursor.fail(Reason.BAD_INDEX_SET, f"{count} rows out of {population}")
    gaps = read_varints(cursor, read_block(cursor, count, _MAX_VARINT * count), count)
    # Each gap is below 2**35 and there are at most 2**27, so that the sum cannot wrap.
    rows = np.cumsum(gaps + np.uint64(1), dtype=np.uint64).astype(np.int64) - 1
    if rows[-1] >= population:
        cursor.fail(Reason.BAD_INDEX_SET, f"row {rows[-1]} is beyond the last of {population}")
    return rows
