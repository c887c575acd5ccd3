"""Frames of layers, written: the base's packets, and behind each segment what refines it (SPEC.md, "Layers")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.layers import union_digest
from decogs.codec.packets.corrections import CorrectedCameras
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.refinement import LAYER_IDS, write_refinement
from decogs.codec.packets.syntax import write_delta
from decogs.codec.scene.state import ARRAYS, Attributes, Rows, State, all_rows, part_of, take_rows
from decogs.formats.stream.container import PacketKind

from .names import IdMap
from .take import Frame
from .writing import FrameWriter, PacketSink


class LayerWriter:
    """Writes frames that have a base as packets of a stream in two layers, which ``sink`` gets.

    Refinements are held back up to the end of a segment: its frames' packets come first. ``finish`` brings the last.
    ``frames``, ``kept`` and ``is_empty`` as of `FrameWriter`.
    """

    kept = 0

    def __init__(self, header: StreamHeader, sink: PacketSink) -> None:
        self._sink, self._block_sink = sink, _Held()
        self._base = FrameWriter(header, sink, IdMap(begins_anew=True))
        uncorrected = replace(header, corrected=CorrectedCameras())
        self._rest = FrameWriter(uncorrected, self._block_sink, IdMap(LAYER_IDS, begins_anew=True))
        self._offsets: tuple[Rows, Attributes] | None = None
        self._first_offsets: tuple[Rows, Attributes] | None = None
        self._pending: list[tuple[int, bytes]] = []
        self.is_empty = True

    @property
    def frames(self) -> int:
        """How many there are so far."""
        return self._base.frames

    def write(self, frame: Frame) -> None:
        """Appends a frame. Raises StreamError for what no packet holds."""
        assert frame.base is not None
        number, is_key = self.frames, frame.is_key or not self.frames
        if is_key:
            self.finish()
        in_base = np.isin(frame.state.ids, frame.base.ids, assume_unique=True)
        self._base.write(replace(frame, state=frame.base, coded=None))
        if is_key:
            self._offsets = self._first_offsets if self._base.refers else None
        rest = part_of(frame.state, ~in_base)
        self._rest.write(replace(frame, state=rest, corrections={}, coded=None))
        aligned, alignment = self._aligned(take_rows(frame.state, np.flatnonzero(in_base)))
        if not number:
            self._first_offsets = self._offsets
        blocks = aligned, self._rest.state
        kind, body = self._block_sink.last
        if kind != PacketKind.SKIP or alignment or not self._base.is_skipped:
            payload = write_refinement(union_digest(blocks), [alignment], kind, body)
            self._pending.append((number, payload))
        self.is_empty = self.is_empty and not len(frame.state)

    def finish(self, frames: int | None = None) -> None:
        """Appends the refinements of the frames so far, or of the first ``frames``."""
        for number, payload in self._pending:
            if frames is None or number < frames:
                self._sink.write(PacketKind.REFINE, number, payload)
        self._pending = []

    def _aligned(self, values: Attributes) -> tuple[State, bytes]:
        """The base's Gaussians with their ``values`` in the whole scene, and the body that takes a reader there."""
        own = self._base.state
        values = take_rows(values, self._base.order)
        expected = self._expected(own)
        delta = difference(expected, np.arange(len(own)), values)
        if not len(delta.rows):
            return expected, b""
        aligned = replace(apply_delta(expected, delta), frame=own.frame)
        self._offsets = own.ids, Attributes(*(getattr(values, n) - getattr(all_rows(own), n) for n in ARRAYS))
        return aligned, write_delta(expected, delta).payload

    def _expected(self, own: State) -> State:
        """The base's Gaussians as a reader has them in the whole scene, before what this frame says of that."""
        if self._offsets is None:
            return own
        ids, offsets = self._offsets
        known = np.isin(own.ids, ids, assume_unique=True)
        of_known = take_rows(offsets, np.searchsorted(ids, own.ids[known]))
        values = {name: getattr(all_rows(own), name).copy() for name in ARRAYS}
        for name, array in values.items():
            array[known] += getattr(of_known, name)
        return new_state(Attributes(**values), own.frame, ids=own.ids, next_id=own.next_id)


class _Held:
    """Keeps the last packet."""

    last: tuple[PacketKind, bytes]

    def write(self, kind: int, frame: int, payload: bytes) -> None:
        self.last = PacketKind(kind), payload
