"""The payloads of key, delta and skip packets, written and read (SPEC.md, "Payloads").

Writers return the payload and its bytes by purpose: "header", "index", "removed", "ids", the attribute groups, and
"added.<group>" for Gaussians that appear. The purposes always add up to the payload's length.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from decogs.formats.stream.container import Packet, PacketKind
from decogs.formats.stream.cursor import Cursor
from decogs.formats.stream.reasons import Reason

from ..coding.entropy import DEFAULT_LEVEL, coded_block, read_block, skip_block
from ..coding.groups import read_groups, read_presence, skip_group, write_groups, write_residuals, write_values
from ..coding.index_sets import read_index_set, read_varints, skip_index_set, write_index_set, write_varints
from ..scene.digest import digest
from ..scene.state import (
    DEFAULT_MAX_GAUSSIANS,
    GROUPS,
    MAX_GAUSSIANS,
    MAX_ID,
    Attributes,
    Integers,
    Rows,
    State,
    all_rows,
    attributes_from_columns,
    empty_attributes,
    group_channels,
    group_columns,
    join_rows,
    take_rows,
)
from .deltas import Changes, Delta, apply_delta, difference, ids_left
from .keyframes import new_state

_KEY = struct.Struct("<QQIBBQ")
_DIGEST = struct.Struct("<Q")
_COUNT = struct.Struct("<I")
_REFERENCE_OFFSET = 20
_INTRA, _FIRST_KEYFRAME = 0, 1
_CONSECUTIVE_IDS, _LISTED_IDS = 0, 1
_MAX_ID_BYTES = 5


class KeyContents(NamedTuple):
    """What a key packet says: its state, the digest it declares, and its changes to the first keyframe.

    One that does not refer to the first keyframe brings all its Gaussians anew.
    """

    state: State
    digest: int
    changes: Changes


class Coded(NamedTuple):
    """A payload and its bytes by purpose."""

    payload: bytes
    costs: dict[str, int]


def write_key(state: State, *, first: State | None = None, level: int = DEFAULT_LEVEL) -> Coded:
    """A key packet's payload: the whole state, or its difference from ``first``, whichever is smaller.

    ``first`` is the state of the stream's first keyframe, None in that keyframe itself.
    """
    _check_count(len(state))
    referring = None if first is None or not _descends(state, first) else _write_referring_key(state, first, level)
    # A late closed segment's own Gaussians have ids too far above the first keyframe's to be listed together.
    if referring is not None and not _can_be_listed(state.ids):
        return referring
    alone = _coded([*_key_head(state, _INTRA, state.ids, level), *_write_new(all_rows(state), level)])
    return alone if referring is None else min(alone, referring, key=lambda coded: len(coded.payload))


def refers_to_first(packet: Packet) -> bool:
    """Whether a packet is a keyframe that can only be read with the stream's first one."""
    head = packet.payload[packet.start : packet.start + _REFERENCE_OFFSET + 1]
    return packet.kind == PacketKind.KEY and len(head) > _REFERENCE_OFFSET and head[-1] == _FIRST_KEYFRAME


def read_key(
    packet: Packet, coefficients: int, max_gaussians: int = DEFAULT_MAX_GAUSSIANS, *, first: State | None = None
) -> KeyContents:
    """The contents of a key packet; raises StreamError.

    ``first``: the state of the stream's first keyframe, for packets that refer to it.
    """
    cursor = packet.cursor()
    declared, next_id, count, reference, mode, first_id = _KEY.unpack(cursor.take(_KEY.size))
    if reference not in (_INTRA, _FIRST_KEYFRAME) or mode not in (_CONSECUTIVE_IDS, _LISTED_IDS):
        cursor.fail(Reason.UNSUPPORTED_MODE, f"reference mode {reference} or id mode {mode} is unknown")
    _check_limit(cursor, count, max_gaussians)
    if max(next_id, first_id) > MAX_ID:
        cursor.fail(Reason.BAD_PAYLOAD, "ids are out of range")
    if reference == _INTRA:
        ids = _read_new_ids(cursor, mode, first_id, count)
        attributes, changes = _read_new(cursor, count, coefficients), Changes(0, count, 0)
    else:
        ids, attributes, changes = _read_referring_key(cursor, count, mode, first_id, first)
    if not (int(ids[-1]) if count else -1) < next_id:
        cursor.fail(Reason.BAD_PAYLOAD, "the next id is not above all ids")
    cursor.finish()
    return KeyContents(new_state(attributes, packet.frame, ids=ids, next_id=next_id), declared, changes)


def write_delta(previous: State, delta: Delta, *, level: int = DEFAULT_LEVEL) -> Coded:
    """A delta packet's payload, applied to ``previous``."""
    state = apply_delta(previous, delta)
    _check_count(len(state))
    return _coded(
        [
            ("header", _DIGEST.pack(digest(state))),
            *_write_changes(len(previous), delta, level),
            ("header", _COUNT.pack(len(delta.added))),
            *_write_added(delta.added, level),
        ]
    )


def read_delta(packet: Packet, previous: State, max_gaussians: int = DEFAULT_MAX_GAUSSIANS) -> tuple[Delta, int]:
    """The delta in a packet and the digest it declares for the state after it; raises StreamError."""
    cursor = packet.cursor()
    declared = cursor.u64()
    rows, residuals, removed = _read_changes(cursor, previous)
    count = cursor.u32()
    _check_limit(cursor, len(previous) - len(removed) + count, max_gaussians)
    if count > ids_left(previous):
        cursor.fail(Reason.BAD_PAYLOAD, "the ids run out")
    added = _read_new(cursor, count, previous.coefficients) if count else empty_attributes(previous.coefficients)
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


def renamed(packet: Packet, old: State, new: State) -> bytes | None:
    """The payload of a packet, from its ``start`` on, that leads to ``new`` where this one leads to ``old``.

    The two hold the same rows under other ids. None for a keyframe that lists its ids otherwise then.
    """
    body = packet.payload[packet.start :]
    if packet.kind != PacketKind.KEY:
        return _DIGEST.pack(digest(new)) + body[_DIGEST.size :]
    _, _, count, reference, mode, first_id = _KEY.unpack(body[: _KEY.size])
    # A keyframe that refers to the first one lists the Gaussians that are younger, perhaps none.
    listed = old.ids >= first_id if reference == _INTRA or first_id else np.zeros(len(old), bool)
    ids = new.ids[listed]
    if not np.array_equal(np.diff(old.ids[listed]), np.diff(ids)):
        return None
    head = _KEY.pack(digest(new), new.next_id, count, reference, mode, int(ids[0]) if len(ids) else 0)
    return head + body[_KEY.size :]


def payload_costs(packet: Packet, coefficients: int, population: int | None = None) -> dict[str, int]:
    """A frame packet's payload bytes by purpose, from its declared lengths; raises StreamError.

    What lies before the packet's ``start`` are its corrections. ``population``: how many Gaussians the state has that
    the packet changes. It may be left out for what this module has written, where an index set with a tag other than
    "empty" holds a row; elsewhere one may not.
    """
    cursor, costs = packet.cursor(), {"header": 0}
    if packet.start:
        costs["corrections"] = packet.start
    if packet.kind == PacketKind.KEY:
        mode = _KEY.unpack(cursor.take(_KEY.size))[4]
        if refers_to_first(packet):
            _change_costs(cursor, coefficients, mode, costs, population)
        else:
            _id_cost(cursor, mode, costs)
            _group_costs(cursor, coefficients, "", costs)
    elif packet.kind == PacketKind.DELTA:
        cursor.u64()
        _change_costs(cursor, coefficients, _CONSECUTIVE_IDS, costs, population)
    else:
        cursor.u64()
    cursor.finish()
    costs["header"] = len(packet.payload) - sum(costs.values())
    return costs


def _change_costs(
    cursor: Cursor, coefficients: int, id_mode: int, costs: dict[str, int], population: int | None
) -> None:
    start = cursor.position
    touched = skip_index_set(cursor, population)
    costs["index"] = cursor.position - start
    if touched:
        _group_costs(cursor, coefficients, "", costs)
    start = cursor.position
    skip_index_set(cursor)
    costs["removed"] = cursor.position - start
    if cursor.u32():
        _id_cost(cursor, id_mode, costs)
        _group_costs(cursor, coefficients, "added.", costs)


def _id_cost(cursor: Cursor, id_mode: int, costs: dict[str, int]) -> None:
    start = cursor.position
    if id_mode == _LISTED_IDS:
        skip_block(cursor)
        costs["ids"] = cursor.position - start


def _group_costs(cursor: Cursor, coefficients: int, prefix: str, costs: dict[str, int]) -> None:
    widths = group_channels(coefficients)
    for group in read_presence(cursor, widths):
        start = cursor.position
        skip_group(cursor, widths[group])
        costs[prefix + group] = cursor.position - start


def _key_head(state: State, reference: int, listed: Rows, level: int) -> list[tuple[str, bytes]]:
    """A key packet's fixed fields, and the ids after the first of ``listed`` where they are not consecutive."""
    first = int(listed[0]) if len(listed) else 0
    consecutive = not len(listed) or int(listed[-1]) - first == len(listed) - 1
    mode = _CONSECUTIVE_IDS if consecutive else _LISTED_IDS
    parts = [("header", _KEY.pack(digest(state), state.next_id, len(state), reference, mode, first))]
    return parts if consecutive else [*parts, ("ids", coded_block(write_varints(_id_gaps(listed)), level))]


def _descends(state: State, first: State) -> bool:
    """Whether ``state`` holds nothing but Gaussians of ``first`` and younger ones."""
    return (
        state.next_id >= first.next_id
        and not np.isin(state.ids[state.ids < first.next_id], first.ids, assume_unique=True, invert=True).any()
    )


def _write_referring_key(state: State, first: State, level: int) -> Coded:
    """Reference 1: what became of the first keyframe's Gaussians, then the younger ones."""
    stays = np.isin(first.ids, state.ids, assume_unique=True)
    old, young = np.split(np.arange(len(state)), [int(stays.sum())])
    rows = np.flatnonzero(stays)
    changes = difference(first, rows, take_rows(state, old), removed=np.flatnonzero(~stays))
    head, *ids = _key_head(state, _FIRST_KEYFRAME, state.ids[young], level)
    count = ("header", _COUNT.pack(len(young)))
    added = _write_added(take_rows(state, young), level)
    return _coded([head, *_write_changes(len(first), changes, level), count, *ids, *added])


def _read_referring_key(
    cursor: Cursor, count: int, mode: int, first_id: int, first: State | None
) -> tuple[Rows, Attributes, Changes]:
    if first is None:
        cursor.fail(Reason.MISSING_KEY, "a keyframe refers to the stream's first one, which is not at hand")
    rows, residuals, removed = _read_changes(cursor, first)
    young = cursor.u32()
    if len(first) - len(removed) + young != count:
        cursor.fail(Reason.BAD_PAYLOAD, f"{count} Gaussians are declared, others are there")
    old = apply_delta(first, Delta(rows, residuals, removed, empty_attributes(first.coefficients)))
    changes = Changes(len(rows), young, len(removed))
    if not young:
        _check_first_id(cursor, first_id)
        return old.ids, all_rows(old), changes
    if first_id < first.next_id:
        cursor.fail(Reason.BAD_PAYLOAD, "an added Gaussian's id is not above the first keyframe's")
    ids = _read_new_ids(cursor, mode, first_id, young)
    attributes = join_rows(old, _read_new(cursor, young, first.coefficients))
    return np.concatenate([old.ids, ids]), attributes, changes


def _write_changes(population: int, delta: Delta, level: int) -> list[tuple[str, bytes]]:
    """Touched rows and their residuals, removed rows."""
    parts = [("index", write_index_set(delta.rows, population, level))]
    if len(delta.rows):
        parts += write_groups(dict(delta.residuals), lambda columns, _: write_residuals(columns, level))
    return [*parts, ("removed", write_index_set(delta.removed, population, level))]


def _read_changes(cursor: Cursor, previous: State) -> tuple[Rows, dict[str, Integers], Rows]:
    population = len(previous)
    rows = read_index_set(cursor, population)
    residuals = read_groups(cursor, len(rows), previous.coefficients, values=False) if len(rows) else {}
    return rows, residuals, read_index_set(cursor, population)


def _write_added(added: Attributes, level: int) -> list[tuple[str, bytes]]:
    if not len(added):
        return []
    return [(name if name == "header" else f"added.{name}", data) for name, data in _write_new(added, level)]


def _write_new(attributes: Attributes, level: int) -> list[tuple[str, bytes]]:
    """Presence byte and groups of whole Gaussians."""
    widths = group_channels(attributes.coefficients)
    columns = {group: group_columns(attributes, group) for group in GROUPS if widths[group]}
    return write_groups(columns, lambda values, group: write_values(values, group, level))


def _read_new(cursor: Cursor, count: int, coefficients: int) -> Attributes:
    return attributes_from_columns(read_groups(cursor, count, coefficients, values=True), count, coefficients)


def _can_be_listed(ids: Rows) -> bool:
    """Whether the gaps between ascending ids are numbers that SPEC.md's varints hold."""
    return int((np.diff(ids) - 1).max(initial=0)) < 1 << 35


def _id_gaps(ids: Rows) -> np.ndarray[tuple[int, ...], np.dtype[np.uint64]]:
    if not _can_be_listed(ids):
        raise ValueError("ids are more than 2**35 apart")
    return (np.diff(ids) - 1).astype(np.uint64)


def _read_new_ids(cursor: Cursor, mode: int, first: int, count: int) -> Rows:
    """The ids of ``count`` whole Gaussians, all below 2**63."""
    if not count:
        _check_first_id(cursor, first)
    if mode == _LISTED_IDS:
        return _read_ids(cursor, first, count)
    if first + count > MAX_ID:
        cursor.fail(Reason.BAD_PAYLOAD, "ids are out of range")
    return first + np.arange(count, dtype=np.int64)


def _check_first_id(cursor: Cursor, first: int) -> None:
    """Where no Gaussian is listed, there is no first id."""
    if first:
        cursor.fail(Reason.BAD_PAYLOAD, "ids are out of range")


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
