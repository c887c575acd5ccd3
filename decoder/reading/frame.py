"""One decoded frame of a stream: what its packet says, and the scene after it."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.layers import LayeredScene, same_blocks, union_of
from decogs.codec.packets.deltas import Changes, Delta
from decogs.codec.packets.frame_payload import FramePayload
from decogs.codec.packets.syntax import payload_costs
from decogs.codec.reconstruct import Reconstruction, reconstruct_frame
from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import Rows, State, part_of, same_scene, take_rows
from decogs.formats.geometry.similarity import transformed_splats
from decogs.formats.splats import Splats, take_splats
from decogs.formats.stream.container import Packet, PacketKind

from .damage import Damage


class _Activation:
    """The values of a state in its world, computed when first asked for; shared by the frames that keep the state."""

    def __init__(self, state: State, header: StreamHeader) -> None:
        self._state, self._lattice = state, header.lattice
        self._transform = header.presentation.similarity

    @cached_property
    def splats(self) -> Splats:
        return transformed_splats(dequantise(self._state, self._lattice), self._transform)

    def of_rows(self, rows: Rows) -> Splats:
        if self._transform.is_identity:
            return dequantise(take_rows(self._state, rows), self._lattice)
        return take_splats(self.splats, rows)  # whose sums of products have the same last bits for every choice


class DecodedFrame:
    """One frame of a stream: what its packet says and the scene after it.

    ``index`` counts frames from 0; ``kind`` is KEY, DELTA or SKIP, which keeps all layers as they are; ``packet_bytes``
    are its bytes on disk, container overhead included; ``state`` is the scene as lattice integers with ids, checked
    against the encoder's digest; ``corrections`` are those of the cameras that the header names: how their pictures
    differ from the scene; ``changes`` how many Gaussians the frame touched, added and removed. A keyframe adds all of
    them, unless it refers to the first one, against which it then counts. ``blocks``: of a stream in layers, those that
    the scene consists of, the base's Gaussians first; None where one packet leads to the scene.

    ``concealed`` is None, unless the frame could not be reconstructed: then it is what is wrong, ``kind`` is None,
    ``packet_bytes`` 0, and the scene that of the last good frame.
    """

    def __init__(
        self,
        payload: FramePayload,
        reconstruction: Reconstruction,
        header: StreamHeader,
        before: DecodedFrame | None,
        first: State | None = None,
        blocks: tuple[State, ...] | None = None,
        refinement_sizes: tuple[int, ...] = (),
    ) -> None:
        packet = payload.body
        self.blocks, self._refinement_sizes = blocks, refinement_sizes
        self.index = packet.frame
        self.kind: PacketKind | None = PacketKind(packet.kind)
        if refinement_sizes and self.kind == PacketKind.SKIP:
            self.kind = PacketKind.DELTA
        self.packet_bytes = packet.size + sum(refinement_sizes)
        self.concealed: Damage | None = None
        self.corrections = payload.corrections
        self._payload: FramePayload | None = payload
        self.state, self.changes, self._delta = reconstruction
        self._coefficients = header.coefficients
        self._state_before = None if before is None else before.state
        base = first if payload.refers_to_first else self._state_before
        self._population_before = None if base is None or blocks is not None else len(base)
        unchanged = before is not None and same_scene(before.state, self.state)
        self._activation: _Activation = before._activation if before and unchanged else _Activation(self.state, header)

    def held(self, index: int, damage: Damage) -> DecodedFrame:
        """This frame shown once more in place of a damaged one."""
        frame = copy(self)
        frame.index, frame.concealed = index, damage
        frame.kind, frame.packet_bytes, frame._payload, frame._delta = None, 0, None, None
        frame.changes = Changes(0, 0, 0)
        frame.state = replace(self.state, frame=index)
        return frame

    def part(self, rows: NDArray[np.bool_], header: StreamHeader) -> DecodedFrame:
        """This frame with the Gaussians of ``rows`` (N,) alone; no delta leads to it."""
        frame = copy(self)
        frame.state = part_of(self.state, rows)
        frame._activation = _Activation(frame.state, header)
        return frame

    @property
    def shows(self) -> int | None:
        """The index of the frame whose scene this is: its own, unless it is held."""
        return self.index if self.concealed is None else self.concealed.held

    @property
    def splats(self) -> Splats:
        """The scene in its world, float32; the very object of the frame before when nothing changed."""
        return self._activation.splats

    def splats_of(self, rows: Rows) -> Splats:
        """The same of some rows alone."""
        return self._activation.of_rows(rows)

    @property
    def refers_to_first(self) -> bool:
        """Whether this is a keyframe coded as the difference from the stream's first one."""
        return self._payload is not None and self._payload.refers_to_first

    @property
    def coded(self) -> Packet | None:
        """Its packet as it is read from behind the corrections on; None when it is concealed, or one of several."""
        return None if self._payload is None or self.blocks is not None else self._payload.body

    @property
    def costs(self) -> dict[str, int]:
        """The payload's bytes by purpose: header, index set, each attribute group (see SPEC.md, "Payloads").

        "refinement": of the layers above the base, whose packets are not split further.
        """
        if self._payload is None:
            return {}
        costs = payload_costs(self._payload.body, self._coefficients, self._population_before)
        return costs | {"refinement": sum(self._refinement_sizes)} if self._refinement_sizes else costs

    @property
    def layer_loads(self) -> list[tuple[int, int]]:
        """Of each layer with those below, Gaussians and bytes on disk."""
        if self.blocks is None:
            return [(len(self.state), self.packet_bytes)]
        sizes = self._refinement_sizes or (0,) * (len(self.blocks) - 1)
        base = self.packet_bytes - sum(sizes)
        return list(zip(accumulate(map(len, self.blocks)), accumulate((base, *sizes)), strict=True))

    def delta_from(self, state: State) -> Delta | None:
        """What this frame changed of ``state``; None unless it is a delta to that scene."""
        before = self._state_before
        return self._delta if before is not None and same_scene(before, state) else None


def decode_frame(
    payload: FramePayload,
    before: DecodedFrame | None,
    header: StreamHeader,
    *,
    first: State | None,
    max_gaussians: int,
) -> DecodedFrame:
    """The frame after ``before``, None where decoding begins, as ``reconstruct_frame`` has it. Raises StreamError."""
    state = None if before is None else before.state
    reconstruction = reconstruct_frame(state, payload, header, first=first, max_gaussians=max_gaussians)
    return DecodedFrame(payload, reconstruction, header, before, first)


def layered_frame(
    payload: FramePayload,
    scene: LayeredScene,
    sizes: tuple[int, ...],
    before: DecodedFrame | None,
    header: StreamHeader,
) -> DecodedFrame:
    """The frame of a ``scene`` in layers, whose refinements have so many bytes on disk."""
    is_same = before is not None and before.blocks is not None and same_blocks(before.blocks, scene.blocks)
    state = replace(before.state, frame=payload.body.frame) if before and is_same else union_of(scene.blocks)
    reconstruction = Reconstruction(state, scene.changes)
    return DecodedFrame(payload, reconstruction, header, before, blocks=scene.blocks, refinement_sizes=sizes)
