"""Packets of an edited take: those that were read where they say the same, new ones where an edit changed a scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import write_corrections
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.syntax import refers_to_first, renamed, write_delta, write_key, write_skip
from decogs.codec.scene.state import Rows, State, all_rows, same_scene, same_values, take_rows
from decogs.formats.stream.container import Packet, PacketKind

from .names import IdMap
from .take import Frame


class PacketSink(Protocol):
    """Takes one packet after the other."""

    def write(self, kind: int, frame: int, payload: bytes) -> object:
        """Appends one packet."""


class FrameWriter:
    """Writes frames as packets of a stream with this header, which ``sink`` has already.

    ``frames`` counts them, ``kept`` those whose packet was taken as it was read, but for its digest and ids.
    ``is_empty``: whether no frame has any Gaussian; ``is_skipped``: whether the last one's packet says that nothing
    changes; ``refers``: whether it is a keyframe that refers to the first one.
    """

    def __init__(self, header: StreamHeader, sink: PacketSink, names: IdMap | None = None) -> None:
        self._header, self._sink = header, sink
        self._names = IdMap() if names is None else names
        self._state: State | None = None
        self._first: State | None = None
        self._source_state: State | None = None  # a source's state whose rows are those of _state, one by one
        self._first_source_state: State | None = None
        self.frames = self.kept = 0
        self.is_empty, self.is_skipped, self.refers = True, False, False
        self._ids: Rows = np.zeros(0, np.int64)

    @property
    def state(self) -> State:
        """The scene of the last frame, as it was written; its rows are those of that frame in their ``order``."""
        assert self._state is not None
        return self._state

    @property
    def order(self) -> Rows:
        """The rows of the last frame in the order of the ids under which they were written."""
        return np.argsort(self._ids)

    def write(self, frame: Frame) -> None:
        """Appends a frame; the first one is a keyframe whatever it was. Raises StreamError for what no packet holds."""
        is_key = frame.is_key or self._state is None
        ids = self._names.of(
            frame.state,
            is_key=is_key,
            lists_all=not self._refers_as_before(frame),
            is_changed=frame.coded is not None and not same_scene(frame.coded.after, frame.state),
        )
        in_order = bool((ids[1:] > ids[:-1]).all())
        self._ids = ids
        after = _with_ids(frame.state, ids, self._names.next_id, in_order, self.frames)
        body = self._as_it_was(frame, after, is_key) if in_order else None
        self.kept += body is not None
        if body is not None and frame.coded is not None:
            kind = frame.coded.packet.kind
        else:
            kind, body, after = self._coded_anew(after, is_key)
        self.is_skipped = kind == PacketKind.SKIP
        self.refers = refers_to_first(Packet(kind, self.frames, body))
        block = write_corrections(frame.corrections, self._header.corrected)
        self._sink.write(kind, self.frames, block + body)
        self._state, self._source_state = after, frame.state if in_order else None
        if self._first is None:
            self._first, self._first_source_state = self._state, self._source_state
        self.frames += 1
        self.is_empty = self.is_empty and not len(after)

    def finish(self) -> None:
        """Nothing is held back."""

    def _as_it_was(self, frame: Frame, after: State, is_key: bool) -> bytes | None:
        """The body of the frame's own packet, with other ids if need be; None where it would say something else."""
        coded = frame.coded
        if coded is None or not same_scene(coded.after, frame.state) or (coded.before is None) != is_key:
            return None
        if coded.before is None:
            follows = not refers_to_first(coded.packet) or self._refers_as_before(frame)
        else:
            follows = self._source_state is not None and same_scene(coded.before, self._source_state)
        return renamed(coded.packet, frame.state, after) if follows else None

    def _refers_as_before(self, frame: Frame) -> bool:
        """Whether the frame's packet refers to a first keyframe that the output has as well."""
        first = None if frame.coded is None else frame.coded.first
        return (
            first is not None and self._first_source_state is not None and same_values(first, self._first_source_state)
        )

    def _coded_anew(self, after: State, is_key: bool) -> tuple[PacketKind, bytes, State]:
        before = self._state
        if is_key or before is None:
            return PacketKind.KEY, write_key(after, first=self._first).payload, after
        stays = np.isin(before.ids, after.ids, assume_unique=True)
        old = int(stays.sum())  # what is new has higher ids, so these come first
        delta = difference(
            before,
            np.flatnonzero(stays),
            take_rows(after, np.arange(old)),
            removed=np.flatnonzero(~stays),
            added=take_rows(after, np.arange(old, len(after))),
        )
        if not (len(delta.rows) or len(delta.removed) or len(delta.added)):
            return PacketKind.SKIP, write_skip(before).payload, replace(before, frame=after.frame)
        return PacketKind.DELTA, write_delta(before, delta).payload, apply_delta(before, delta)


def _with_ids(state: State, ids: Rows, next_id: int, in_order: bool, frame: int) -> State:
    """The scene under the output's ids, in their order."""
    if in_order and next_id == state.next_id and np.array_equal(ids, state.ids):
        return replace(state, frame=frame)
    attributes = all_rows(state)
    if not in_order:
        order = np.argsort(ids)
        attributes, ids = take_rows(state, order), ids[order]
    return new_state(attributes, frame, ids=ids, next_id=next_id)
