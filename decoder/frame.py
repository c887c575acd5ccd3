"""One decoded frame of a stream: what its packet says, and the scene after it."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

from decogs.codec.corrections import split_corrections
from decogs.codec.deltas import Delta
from decogs.codec.header import StreamHeader
from decogs.codec.lattice import Lattice, dequantise
from decogs.codec.state import MAX_GAUSSIANS, State, same_scene
from decogs.codec.syntax import key_changes, payload_costs, read_delta, refers_to_first
from decogs.formats.container import Packet, PacketKind
from decogs.formats.splats import Splats

from .damage import Damage


class _Activation:
    """The stored values of a state, computed when first asked for; shared by the frames that keep the state."""

    def __init__(self, state: State, lattice: Lattice) -> None:
        self._state, self._lattice = state, lattice

    @cached_property
    def splats(self) -> Splats:
        return dequantise(self._state, self._lattice)


class DecodedFrame:
    """One frame of a stream: what its packet says and the scene after it.

    ``index`` counts frames from 0; ``kind`` is KEY, DELTA or SKIP; ``packet_bytes`` are its bytes on disk, container
    overhead included; ``state`` is the scene as lattice integers with ids, checked against the encoder's digest;
    ``corrections`` tell of the cameras that the header names how their pictures differ from the scene.

    ``concealed`` is None, unless the frame could not be reconstructed: then it is what is wrong, ``kind`` is None,
    ``packet_bytes`` 0, and the scene that of the last good frame.
    """

    def __init__(
        self,
        packet: Packet,
        state: State,
        header: StreamHeader,
        before: DecodedFrame | None,
        first: State | None = None,
    ) -> None:
        self.index = packet.frame
        self.kind: PacketKind | None = PacketKind(packet.kind)
        self.packet_bytes = packet.size
        self.state = state
        self.concealed: Damage | None = None
        self._packet: Packet | None
        self.corrections, self._packet = split_corrections(packet, header.corrected)
        self._coefficients = header.coefficients
        self._state_before = None if before is None else before.state
        self._first = first
        unchanged = before is not None and self.kind == PacketKind.SKIP
        self._activation: _Activation = (
            before._activation if before and unchanged else _Activation(state, header.lattice)
        )

    def held(self, index: int, damage: Damage) -> DecodedFrame:
        """This frame shown once more in place of a damaged one."""
        frame = copy(self)
        frame.index, frame.concealed = index, damage
        frame.kind, frame.packet_bytes, frame._packet = None, 0, None
        frame.state = replace(self.state, frame=index)
        return frame

    @property
    def shows(self) -> int | None:
        """The index of the frame whose scene this is: its own, unless it is held."""
        return self.index if self.concealed is None else self.concealed.held

    @property
    def splats(self) -> Splats:
        """The scene as stored values, float32; the very object of the frame before when nothing changed."""
        return self._activation.splats

    @property
    def refers_to_first(self) -> bool:
        """Whether this is a keyframe told as the difference from the stream's first one."""
        return self._packet is not None and refers_to_first(self._packet)

    @property
    def costs(self) -> dict[str, int]:
        """The payload's bytes by purpose: header, index set, each attribute group (see SPEC.md, "Payloads")."""
        if self._packet is None:
            return {}
        base = self._first if self.kind == PacketKind.KEY else self._state_before
        return payload_costs(self._packet, self._coefficients, None if base is None else len(base))

    def delta_from(self, state: State) -> Delta | None:
        """What this frame changed of ``state``, read from its packet again; None unless it is a delta to that scene."""
        before = self._state_before
        if self._packet is None or self.kind != PacketKind.DELTA or before is None or not same_scene(before, state):
            return None
        delta, _ = read_delta(self._packet, before, max_gaussians=MAX_GAUSSIANS)
        return delta

    @property
    def changes(self) -> Changes:
        """How many Gaussians this frame touched, added and removed; a keyframe brings all of them anew.

        One that refers to the first keyframe counts against that.
        """
        delta = None if self._state_before is None else self.delta_from(self._state_before)
        if delta is not None:
            return Changes(len(delta.rows), len(delta.added), len(delta.removed))
        if self._first is not None and self._packet is not None:
            return Changes(*key_changes(self._packet, self._first))
        return Changes(0, len(self.state) if self.kind == PacketKind.KEY else 0, 0)


@dataclass(frozen=True)
class Changes:
    """Numbers of Gaussians: existing ones whose values changed, new ones, and ones that went."""

    touched: int
    added: int
    removed: int
