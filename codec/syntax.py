"""The payloads of key, delta and skip packets, written and read (SPEC.md, "Payloads").

Writers return the payload and its bytes by purpose: "header", "index", "removed", "ids", the attribute groups, and
"added.<group>" for Gaussians that appear. The purposes always add up to the payload's length.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from decogs.formats.container import Packet, PacketKind
from decogs.formats.cursor import Cursor
from decogs.formats.reasons import Reason

from .deltas import Delta, apply_delta, ids_left
from .digest import digest
from .entropy import DEFAULT_LEVEL, coded_block, read_block, skip_block
from .groups import read_groups, read_presence, skip_group, write_groups, write_residuals, write_values
from .index_sets import read_index_set, read_varints, skip_index_set, write_index_set, write_varints
from .keyframes import new_state
from .state import (
    DEFAULT_MAX_GAUSSIANS,
    GROUPS,
    MAX_GAUSSIANS,
    MAX_ID,
    Attributes,
    Rows,
    State,
    attributes_from_columns,
    empty_attributes,
    group_channels,
    group_columns,
)

_KEY = struct.Struct("<QQIBBQ")
_DIGEST = struct.Struct("<Q")
_COUNT = struct.Struct("<I")
_INTRA = 0
_CONSECUTIVE_IDS, _LISTED_IDS = 0, 1
_MAX_ID_BYTES = 5


class Coded(NamedTuple):
    """A payload and its bytes by purpose."""

    payload: bytes
    costs: dict[str, int]


def write_key(state: State, *, level: int = DEFAULT_LEVEL) -> Coded:
    """A key packet's payload: the whole state, referring to nothing."""
    _check_count(len(state))
    first = int(state.ids[0]) if len(state) else 0
    consecutive = not len(state) or int(state.ids[-1]) - first == len(state) - 1
    mode = _CONSECUTIVE_IDS if consecutive else _LISTED_IDS
    parts = [("header", _KEY.pack(digest(state), state.next_id, len(state), _INTRA, mode, first))]
    if not consecutive:
        parts.append(("ids", coded_block(write_varints(_id_gaps(state.ids)), level)))
    return _coded([*parts, *_write_new(state, level)])


def read_key(packet: Packet, coefficients: int, max_gaussians: int = DEFAULT_MAX_GAUSSIANS) -> tuple[State, int]:
    """The state of a key packet and the digest it declares; raises StreamError."""
    cursor = packet.cursor()
    declared, next_id, count, reference, mode, first = _KEY.unpack(cursor.take(_KEY.size))
    if reference != _INTRA or mode not in (_CONSECUTIVE_IDS, _LISTED_IDS):
        cursor.fail(Reason.UNSUPPORTED_MODE, f"reference mode {reference} or id mode {mode} is unknown")
    _check_limit(cursor, count, max_gaussians)
    if max(next_id, first) > MAX_ID or (not count and first):
        cursor.fail(Reason.BAD_PAYLOAD, "ids are out of range")
    ids = first + np.arange(count, dtype=np.int64) if mode == _CONSECUTIVE_IDS else _read_ids(cursor, first, count)
    if count and not 0 <= int(ids[-1]) < next_id:
        cursor.fail(Reason.BAD_PAYLOAD, "the next id is not above all ids")
    attributes = _read_new(cursor, count, coefficients)
    cursor.finish()
    return new_state(attributes, packet.frame, ids=ids, next_id=next_id), declared


def write_delta(previous: State, delta: Delta, *, level: int = DEFAULT_LEVEL) -> Coded:
    """A delta packet's payload, applied to ``previous``."""
    state = apply_delta(previous, delta)
    _check_count(len(state))
    parts = [("header", _DIGEST.pack(digest(state)))]
    parts.append(("index", write_index_set(delta.rows, len(previous), level)))
    if len(delta.rows):
        parts += write_groups(dict(delta.residuals), lambda columns, _: write_residuals(columns, level))
    parts.append(("removed", write_index_set(delta.removed, len(previous), level)))
    parts.append(("header", _COUNT.pack(len(delta.added))))
    if len(delta.added):
        parts += [
            (name if name == "header" else f"added.{name}", data) for name, data in _write_new(delta.added, level)
        ]
    return _coded(parts)


def read_delta(packet: Packet, previous: State, max_gaussians: int = DEFAULT_MAX_GAUSSIANS) -> tuple[Delta, int]:
    """The delta in a packet and the digest it declares for the state after it; raises StreamError."""
    cursor = packet.cursor()
    population, coefficients = len(previous), previous.coefficients
    declared = cursor.u64()
    rows = read_index_set(cursor, population)
    residuals = read_groups(cursor, len(rows), coefficients, values=False) if len(rows) else {}
    removed = read_index_set(cursor, population)
    count = cursor.u32()
    _check_limit(cursor, population - len(removed) + count, max_gaussians)
    if count > ids_left(previous):
        cursor.fail(Reason.BAD_PAYLOAD, "the ids run out")
    added = _read_new(cursor, count, coefficients) if count else empty_attributes(coefficients)
    cursor.finish()
    return Delta(rows, residuals, removed, added), declared


def write_skip(state: State) -> Coded:
    """A skip packet's payload: the digest of the state that stays."""
    return _coded([("header", _DIGEST.pack(digest(state)))])


def read_skip(packet: Packet) -> int:
    """The digest a skip packet declares; raises StreamError."""
    cursor = packet.cursor()
    declared = cursor.u64()
    cursor.finish()
    return declared


def payload_costs(packet: Packet, coefficients: int) -> dict[str, int]:
    """A frame packet's payload bytes by purpose, from its declared lengths, without decoding it; raises StreamError."""
    cursor, costs = packet.cursor(), {"header": 0}
    if packet.kind == PacketKind.KEY:
        mode, count = _KEY.unpack(cursor.take(_KEY.size))[4], None
        if mode == _LISTED_IDS:
            skip_block(cursor)
            costs["ids"] = cursor.position - _KEY.size
        _group_costs(cursor, coefficients, "", costs)
    elif packet.kind == PacketKind.DELTA:
        cursor.u64()
        costs["index"] = _set_cost(cursor)
        if costs["index"] > 1 or packet.payload[_DIGEST.size : _DIGEST.size + 1] != b"\0":
            _group_costs(cursor, coefficients, "", costs)
        costs["removed"] = _set_cost(cursor)
        count = cursor.u32()
        if count:
            _group_costs(cursor, coefficients, "added.", costs)
    else:
        cursor.u64()
    cursor.finish()
    costs["header"] = len(packet.payload) - sum(costs.values())
    return costs


def _group_costs(cursor: Cursor, coefficients: int, prefix: str, costs: dict[str, int]) -> None:
    widths = group_channels(coefficients)
    for group in read_presence(cursor, widths):
        start = cursor.position
        skip_group(cursor, widths[group])
        costs[prefix + group] = cursor.position - start


def _set_cost(cursor: Cursor) -> int:
    start = cursor.position
    skip_index_set(cursor)
    return cursor.position - start


def _write_new(attributes: Attributes, level: int) -> list[tuple[str, bytes]]:
    """Presence byte and groups of whole Gaussians."""
    widths = group_channels(attributes.coefficients)
    columns = {group: group_columns(attributes, group) for group in GROUPS if widths[group]}
    return write_groups(columns, lambda values, group: write_values(values, group, level))


def _read_new(cursor: Cursor, count: int, coefficients: int) -> Attributes:
    return attributes_from_columns(read_groups(cursor, count, coefficients, values=True), count, coefficients)


def _id_gaps(ids: Rows) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    gaps = np.diff(ids) - 1
    if gaps.max(initial=0) >= 1 << 35:
        raise ValueError("ids are more than 2**35 apart")
    return gaps.astype(np.uint64)


def _read_ids(cursor: Cursor, first: int, count: int) -> Rows:
    """Listed ids; gaps are below 2**35 and at most 2**27 in number, so that the sum stays below 2**64."""
    others = max(0, count - 1)
    gaps = read_varints(cursor, read_block(cursor, others, _MAX_ID_BYTES * others), others)
    ids = np.cumsum(np.concatenate([np.full(min(count, 1), first, np.uint64), gaps + np.uint64(1)]), dtype=np.uint64)
    if count and int(ids[-1]) > MAX_ID:
        cursor.fail(Reason.BAD_PAYLOAD, "ids are out of range")
    return ids.astype(np.int64)


def _check_limit(cursor: Cursor, count: int, max_gaussians: int) -> None:
    if count > min(max_gaussians, MAX_GAUSSIANS):
        cursor.fail(Reason.TOO_MANY_GAUSSIANS, f"{count} Gaussians are above the limit of {max_gaussians}")


def _check_count(count: int) -> None:
    if count > MAX_GAUSSIANS:
        raise ValueError(f"{count} Gaussians are more than a stream can hold")


def _coded(parts: Iterable[tuple[str, bytes]]) -> Coded:
    parts = list(parts)
    costs: dict[str, int] = {}
    for name, data in parts:
        costs[name] = costs.get(name, 0) + len(data)
    return Coded(b"".join(data for _, data in parts), costs)
