"""Attribute groups: integers of one attribute, predicted, zigzagged, in byte planes (SPEC.md, "Attribute group")."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.stream.cursor import Cursor
from decogs.formats.stream.reasons import Reason

from ..scene.morton import AXIS_BITS, morton_codes, morton_positions
from ..scene.state import GROUPS, IntArray, Integers, group_channels
from .entropy import coded_block, read_block, skip_block
from .planes import PlaneCounts, join_planes, split_planes, unzigzag, zigzag

ZERO, PREVIOUS_ROW, OFFSET, MORTON, CHANNELS = 0, 1, 2, 3, 4
"""Prediction modes: nothing, the row before, a constant per channel, gaps between Morton codes (means only), the same
row's channel before and a constant."""

RESIDUAL_MODES = (ZERO,)
VALUE_MODES = (ZERO, PREVIOUS_ROW, OFFSET, CHANNELS)

_INT32 = np.dtype("<i4")


@dataclass(frozen=True)
class GroupHeader:
    """What stands before a group's coded block: mode, constants per channel (modes 2 to 4), planes per channel."""

    mode: int
    offsets: IntArray
    counts: PlaneCounts


def write_residuals(residuals: Integers, level: int) -> bytes:
    """The residuals (n, channels) of existing rows, prediction mode 0."""
    return _write_plain(ZERO, residuals, level)


def write_values(values: IntArray, group: str, level: int) -> bytes:
    """The values (n, channels) of new rows in the mode that measures smallest."""
    candidates = [_write_plain(ZERO, values, level), _write_plain(PREVIOUS_ROW, _row_differences(values), level)]
    candidates.append(_write_offset(OFFSET, values, level))
    if values.shape[1] > 1:
        candidates.append(_write_offset(CHANNELS, _channel_differences(values), level))
    if group == "means" and (gaps := _write_morton(values, level)) is not None:
        candidates.append(gaps)
    return min(candidates, key=len)


def read_group(cursor: Cursor, group: str, n: int, channels: int, *, values: bool) -> Integers:
    """The integers (n, channels) of one group; ``values``: of new rows, else residuals of existing ones.

    Raises StreamError "unsupported-mode", "bad-payload" or "bad-compression".
    """
    header = read_group_header(cursor, channels)
    allowed = VALUE_MODES if values else RESIDUAL_MODES
    if header.mode not in allowed and not (values and group == "means" and header.mode == MORTON):
        cursor.fail(Reason.UNSUPPORTED_MODE, f"prediction mode {header.mode} is unknown for {group}")
    size = int(header.counts.sum(dtype=np.int64)) * n
    data = read_block(cursor, size, size)
    if header.mode == MORTON:
        return _morton_values(cursor, header, data, n)
    integers = np.ascontiguousarray(unzigzag(join_planes(header.counts, data, n)))
    if header.mode == PREVIOUS_ROW:
        return np.cumsum(integers, axis=0, dtype=np.int32)
    if header.mode in (OFFSET, CHANNELS):
        integers = integers + header.offsets
    return np.cumsum(integers, axis=1, dtype=np.int32) if header.mode == CHANNELS else integers


def read_group_header(cursor: Cursor, channels: int) -> GroupHeader:
    """Mode, constants and plane counts, checked against their bounds."""
    mode = cursor.u8()
    offsets = np.zeros(0, np.int32)
    if mode in (OFFSET, MORTON, CHANNELS):
        offsets = np.frombuffer(cursor.take(4 * channels), _INT32).astype(np.int32)
    counts = np.frombuffer(cursor.take(1 if mode == MORTON else channels), np.uint8)
    if counts.max(initial=0) > (8 if mode == MORTON else 4):
        cursor.fail(Reason.BAD_PAYLOAD, f"a channel declares {counts.max()} byte planes")
    return GroupHeader(mode, offsets, counts)


def skip_group(cursor: Cursor, channels: int) -> None:
    """Passes over a group without decoding it."""
    read_group_header(cursor, channels)
    skip_block(cursor)


def write_groups(columns: dict[str, IntArray], write: Callable[[IntArray, str], bytes]) -> list[tuple[str, bytes]]:
    """The presence byte, named "header", and each group that is not all zero."""
    present = [group for group in GROUPS if group in columns and columns[group].any()]
    mask = sum(1 << GROUPS.index(group) for group in present)
    return [("header", bytes([mask])), *((group, write(columns[group], group)) for group in present)]


def read_groups(cursor: Cursor, n: int, coefficients: int, *, values: bool) -> dict[str, Integers]:
    """The groups that the presence byte announces, (n, channels) each."""
    widths = group_channels(coefficients)
    return {
        group: read_group(cursor, group, n, widths[group], values=values) for group in read_presence(cursor, widths)
    }


def read_presence(cursor: Cursor, widths: dict[str, int]) -> list[str]:
    """The groups a presence byte names, in wire order."""
    mask = cursor.u8()
    allowed = sum(1 << bit for bit, group in enumerate(GROUPS) if widths[group])
    if mask & ~allowed:
        cursor.fail(Reason.RESERVED_BITS, "a presence byte names a group that cannot be there")
    return [group for bit, group in enumerate(GROUPS) if mask >> bit & 1]


def _row_differences(values: IntArray) -> IntArray:
    return np.diff(values, axis=0, prepend=np.zeros((1, values.shape[1]), np.int32))


def _channel_differences(values: IntArray) -> IntArray:
    return np.diff(values, axis=1, prepend=np.zeros((len(values), 1), np.int32))


def _write_plain(mode: int, residuals: Integers, level: int) -> bytes:
    counts, data = split_planes(zigzag(residuals))
    return bytes([mode]) + counts.tobytes() + coded_block(data, level)


def _write_offset(mode: int, values: IntArray, level: int) -> bytes:
    """Modes 2 and 4 around the channel's median, where its values are densest."""
    offsets = np.sort(values, axis=0)[len(values) // 2] if len(values) else np.zeros(values.shape[1], np.int32)
    counts, data = split_planes(zigzag(values - offsets))
    return bytes([mode]) + offsets.astype(_INT32).tobytes() + counts.tobytes() + coded_block(data, level)


def _write_morton(means: IntArray, level: int) -> bytes | None:
    """Mode 3, or None when the rows are not in Morton order or span more than 21 bits on an axis."""
    if not len(means):
        return None
    origin = means.min(axis=0)
    if int((means.max(axis=0).astype(np.int64) - origin).max()) >= 1 << AXIS_BITS:
        return None
    codes = morton_codes(means, origin.astype(np.int64))
    if (codes[1:] < codes[:-1]).any():
        return None
    gaps: NDArray[np.uint64] = np.diff(codes, prepend=np.uint64(0))
    counts, data = split_planes(gaps[:, None])
    constants = np.asarray(origin, _INT32).tobytes()
    return b"".join((bytes([MORTON]), constants, counts.tobytes(), coded_block(data, level)))


def _morton_values(cursor: Cursor, header: GroupHeader, data: bytes, n: int) -> IntArray:
    gaps = join_planes(header.counts, data, n)[:, 0].astype(np.uint64)
    codes = np.cumsum(gaps, dtype=np.uint64)
    if n and ((codes[1:] < codes[:-1]).any() or int(codes[-1]) >> (3 * AXIS_BITS)):
        cursor.fail(Reason.BAD_PAYLOAD, "Morton codes leave their 63 bits")
    return morton_positions(codes).astype(np.int32) + header.offsets
