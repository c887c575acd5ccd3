"""The scene as a decoder has it after a frame, and how packets lead from one to the next.

Chosen: the encoder reconstructs the state from the very bytes that it writes, so that quantisation errors cannot add
up. Rejected: training on the encoder's own floats and quantising afterwards (the error of a frame is never seen again).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import State, same_values
from decogs.formats.splats import Splats
from decogs.formats.stream.container import Packet, PacketKind

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
    def open(cls, header: StreamHeader, key: State) -> Scene:
        """The scene of a stream's first keyframe."""
        return cls(header, key, key, dequantise(key, header.lattice))

    def read(self, packet: Packet) -> State:
        """The state after the next packet, as a decoder has it."""
        return reconstruct(self.state, packet, self.header, first=self.first)

    def after(self, state: State) -> Scene:
        """The scene whose next state is ``state``."""
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

    def is_left_by(self, packet: Packet, after: State) -> bool:
        """Whether the next packet is another scene's keyframe: the state ``after`` it has younger Gaussians only."""
        is_key = packet.kind == PacketKind.KEY
        return is_key and bool(len(after.ids)) and int(after.ids[0]) >= self.state.next_id

    def _with(self, state: State) -> Scene:
        return replace(self, state=state, splats=dequantise(state, self.header.lattice))
