"""The scene as a decoder has it: frames become packets, and packets the state that the next frame begins with.

Chosen: the encoder reconstructs the state from the very bytes that it writes, so that quantisation errors cannot add
up. Rejected: training on the encoder's own floats and quantising afterwards (the error of a frame is never seen again).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from decogs.codec.corrections import Corrections, write_corrections
from decogs.codec.deltas import Delta, apply_delta, difference
from decogs.codec.header import StreamHeader
from decogs.codec.lattice import dequantise, quantise
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import State, take_rows
from decogs.codec.syntax import Coded, write_delta, write_key, write_skip
from decogs.formats.container import Packet, PacketKind
from decogs.formats.splats import FloatArray, Splats

from ..output.stream_output import StreamOutput
from ..settings.frame import SignificanceSettings
from ..training.method import TrainedFrame
from .quantised_changes import quantised

IDS_PER_SEGMENT = 1 << 31
"""Ids set aside for each closed segment: an id is never given twice, though segments do not know of each other."""


@dataclass(frozen=True)
class Written:
    """A packet that was written, and the bytes of its payload by purpose."""

    packet: Packet
    costs: dict[str, int]


class CodedScene:
    """The reconstructed state of a stream that grows.

    ``level``: zstd's. ``segment``: frames from one keyframe to the next, 0 for a single one. ``state``: the scene after
    the last packet, on the lattice; ``splats``: the same as stored values.
    """

    state: State
    splats: Splats

    def __init__(self, header: StreamHeader, output: StreamOutput, *, level: int, segment: int) -> None:
        self.header = header
        self._output: StreamOutput | None = output
        self._level, self._segment = level, segment
        self._first: State | None = None

    @property
    def is_open(self) -> bool:
        """Whether the first keyframe is there."""
        return self._first is not None

    @property
    def first(self) -> State:
        """The state of the first keyframe, which must be there."""
        assert self._first is not None
        return self._first

    def begin(self, state: State, corrections: Corrections) -> Written:
        """Writes the header and the first keyframe; the output begins only now."""
        if self._output is not None:
            self._output.begin(self.header.to_bytes())
        return self._write(PacketKind.KEY, 0, write_key(state, level=self._level), corrections)

    def begin_anew(self, state: State, corrections: Corrections) -> Written:
        """Writes a keyframe in which nothing is left of the scene before it; ``state`` has `next_id` and later ids."""
        coded = write_key(replace(state, frame=self.state.frame + 1), level=self._level)
        return self._write(PacketKind.KEY, self.state.frame + 1, coded, corrections)

    def code(
        self,
        frame: int,
        trained: TrainedFrame | None,
        significance: SignificanceSettings,
        corrections: Corrections,
        *,
        whole: bool = False,
    ) -> Written:
        """Writes the frame, counted from the stream's first, as key, delta or skip, whichever is smallest.

        ``trained``: what it changed of the state, None for nothing. ``significance``: how exactly changes are coded.
        ``whole``: the decoder's state is not this one (`go_back`), so the frame is a keyframe.
        """
        delta = None if trained is None else self._delta(trained, significance)
        if delta is not None and not (len(delta.rows) or len(delta.removed) or len(delta.added)):
            delta = None
        before = self.state
        if whole or (self._segment and frame % self._segment == 0):
            after = replace(before, frame=frame) if delta is None else apply_delta(before, delta)
            return self._write(
                PacketKind.KEY, frame, write_key(after, first=self._first, level=self._level), corrections
            )
        if delta is None:
            return self._write(PacketKind.SKIP, frame, write_skip(before), corrections)
        return self._write(PacketKind.DELTA, frame, write_delta(before, delta, level=self._level), corrections)

    def take(self, packet: Packet) -> None:
        """Reconstructs the next state from a packet, as a decoder does."""
        before = self.state if self.is_open else None
        self.state = reconstruct(before, packet, self.header, first=self._first)
        if self._first is None:
            self._first = self.state
        self.splats = dequantise(self.state, self.header.lattice)

    def repeat(self, packet: Packet) -> None:
        """Takes a packet that was made for this state, and writes it."""
        self.take(packet)
        if self._output is not None:
            self._output.write(packet.kind, packet.frame, packet.payload)

    def go_back(self, state: State) -> None:
        """Takes an earlier state for the next frame's; ids of Gaussians that came since are not given again."""
        self.state = replace(state, frame=self.state.frame, next_id=self.state.next_id)
        self.splats = dequantise(self.state, self.header.lattice)

    def restart(self, frame: int) -> None:
        """Takes the first keyframe's state for the one before ``frame``, which begins a closed segment."""
        first = self.first
        next_id = first.next_id + frame // self._segment * IDS_PER_SEGMENT
        self.state = replace(first, frame=frame - 1, next_id=next_id)
        self.splats = dequantise(first, self.header.lattice)

    def unwritten(self) -> CodedScene:
        """The same scene, to go on with apart from this one; nothing of that is written."""
        other = copy(self)
        other._output = None
        return other

    def rehearse(self, trained: TrainedFrame, significance: SignificanceSettings) -> None:
        """Takes what would be coded of a frame, without writing it: training goes on from there."""
        after = apply_delta(self.state, self._delta(trained, significance))
        self.state = replace(after, frame=self.state.frame)
        self.splats = dequantise(self.state, self.header.lattice)

    def displacements(self, before: State) -> FloatArray:
        """How far every Gaussian moved since ``before``, (N, 3) world units; 0 for new ones."""
        motion = np.zeros((len(self.state), 3), np.float32)
        _, was, now = np.intersect1d(before.ids, self.state.ids, assume_unique=True, return_indices=True)
        steps = self.state.means[now].astype(np.float64) - before.means[was]
        motion[now] = steps * np.asarray(self.header.lattice.means)
        return motion

    def _delta(self, trained: TrainedFrame, significance: SignificanceSettings) -> Delta:
        lattice, before = self.header.lattice, take_rows(self.state, trained.kept)
        current = quantised(trained.values, before, lattice, trained.sensitivity, significance)
        added = quantise(trained.added, lattice)
        return difference(self.state, trained.kept, current, removed=trained.removed, added=added)

    def _write(self, kind: PacketKind, frame: int, coded: Coded, corrections: Corrections) -> Written:
        """Reconstructs the next state from the packet's bytes and writes the packet."""
        coded = self._with_corrections(coded, corrections)
        packet = Packet(kind=kind, critical=True, frame=frame, payload=coded.payload, offset=0, ordinal=frame + 1)
        self.repeat(packet)
        return Written(packet, coded.costs)

    def _with_corrections(self, coded: Coded, corrections: Corrections) -> Coded:
        """The payload as the packet has it: the block of corrections before it, if the stream has one."""
        cameras = self.header.corrected
        if not cameras.effects:
            return coded
        block = write_corrections(corrections, cameras)
        return Coded(block + coded.payload, {**coded.costs, "corrections": len(block)})
