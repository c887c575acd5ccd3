"""The scene as a decoder has it after a frame, and how packets lead from one to the next.

Chosen: the encoder reconstructs the state from the very bytes that it writes, so that quantisation errors cannot add
up. Rejected: training on the encoder's own floats and quantising afterwards (the error of a frame is never seen again).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from decogs.codec.deltas import apply_delta
from decogs.codec.header import StreamHeader
from decogs.codec.lattice import dequantise
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import State, same_values
from decogs.formats.container import Packet, PacketKind
from decogs.formats.splats import FloatArray, Splats

from ..settings.frame import SignificanceSettings
from ..training.method import TrainedFrame
from .changes import delta_of

IDS_PER_SEGMENT = 1 << 31
"""Ids set aside for each closed segment: an id is never given twice, though segments do not know of each other."""
_IDS_PER_FRAME = 1 << 13
"""The same for each frame of segments that start from a cut's keyframe. A whole keyframe lists its ids, at most 2^35
apart (SPEC.md, "Varint"): enough for 2^22 frames of one scene, of which each adds some hundred Gaussians."""


@dataclass(frozen=True)
class Scene:
    """The Gaussians of a stream after a frame: ``state`` on the lattice, ``splats`` as stored values.

    ``first``: the state of the stream's first keyframe, from which later ones are coded.
    """

    header: StreamHeader
    first: State
    state: State
    splats: Splats

    @classmethod
    def open(cls, header: StreamHeader, packet: Packet) -> Scene:
        """The scene of a stream's first keyframe."""
        state = reconstruct(None, packet, header)
        return cls(header, state, state, dequantise(state, header.lattice))

    def after(self, packet: Packet) -> Scene:
        """The scene after the next packet, as a decoder has it."""
        state = reconstruct(self.state, packet, self.header, first=self.first)
        return self._with(state) if not same_values(self.state, state) else replace(self, state=state)

    def with_changes(self, trained: TrainedFrame, significance: SignificanceSettings) -> Scene:
        """The scene with a frame's changes as they would be coded, the same frame still to come."""
        after = apply_delta(self.state, delta_of(self.state, self.header.lattice, trained, significance))
        return self._with(replace(after, frame=self.state.frame))

    def roll_back(self, state: State) -> Scene:
        """An earlier ``state`` for the next frame's; ids of Gaussians that came since are not given again."""
        return self._with(replace(state, frame=self.state.frame, next_id=self.state.next_id))

    def restart(self, key: State, frame: int, segment: int) -> Scene:
        """The state of the first keyframe or a cut's as the one before ``frame``, which begins a closed segment."""
        since = (frame - key.frame) * _IDS_PER_FRAME if key.frame else frame // segment * IDS_PER_SEGMENT
        return self._with(replace(key, frame=frame - 1, next_id=key.next_id + since))

    def id_of_cut(self, frame: int, segment: int) -> int:
        """The first id of a keyframe in ``frame`` of closed segments: it follows from the frame alone."""
        return self.first.next_id + frame * IDS_PER_SEGMENT // segment

    def before_cut(self, frame: int, first_id: int) -> Scene:
        """The scene as the one before a cut in ``frame``, whose ids begin with ``first_id`` unless that is taken."""
        return replace(self, state=replace(self.state, frame=frame - 1, next_id=max(self.state.next_id, first_id)))

    def displacements(self, before: State) -> FloatArray:
        """How far every Gaussian moved since ``before``, (N, 3) world units; 0 for new ones."""
        motion = np.zeros((len(self.state), 3), np.float32)
        _, was, now = np.intersect1d(before.ids, self.state.ids, assume_unique=True, return_indices=True)
        steps = self.state.means[now].astype(np.float64) - before.means[was]
        motion[now] = steps * np.asarray(self.header.lattice.means)
        return motion

    def begins_anew(self, packet: Packet) -> bool:
        """Whether a packet is the keyframe of another scene: all its Gaussians are younger than any before."""
        if packet.kind != PacketKind.KEY:
            return False
        ids = reconstruct(self.state, packet, self.header, first=self.first).ids
        return bool(len(ids)) and int(ids[0]) >= self.state.next_id

    def _with(self, state: State) -> Scene:
        return replace(self, state=state, splats=dequantise(state, self.header.lattice))
