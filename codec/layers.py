"""Layers: a scene whose most useful Gaussians stand alone, and what makes it whole (SPEC.md, "Layers").

Every layer is a block of Gaussians with packets of its own. The base's are the frames of the stream, which every reader
plays. A lower block may have other values in a higher layer: they differ by integers that stay from frame to frame, so
that what a frame adds to the one, it adds to the other. A reader of a higher layer need not know the lower one's, but
at keyframes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, NoReturn

import numpy as np

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import PACKET_HEADER_SIZE, Packet, PacketKind
from decogs.formats.stream.reasons import Reason

from .header.header import StreamHeader
from .packets.deltas import Changes, apply_delta
from .packets.frame_payload import FramePayload
from .packets.keyframes import new_state
from .packets.refinement import LAYER_IDS, Refinement
from .packets.syntax import read_delta, refers_to_first
from .reconstruct import reconstruct_frame
from .scene.digest import MASK, combine
from .scene.state import (
    ARRAYS,
    DEFAULT_MAX_GAUSSIANS,
    Attributes,
    State,
    all_rows,
    read_only,
    same_scene,
    take_rows,
)


class FirstKeyframe(NamedTuple):
    """The blocks of the first keyframe: as their own packets have them, and as the top layer has them."""

    own: tuple[State, ...]
    aligned: tuple[State, ...]


class LayeredScene(NamedTuple):
    """A frame's ``blocks`` of Gaussians as its top layer has them, the base's first, and what the frame changed."""

    blocks: tuple[State, ...]
    changes: Changes


def union_digest(blocks: Sequence[State]) -> int:
    """The digest of all blocks' Gaussians together, as of one state."""
    total = sum(block.row_sum for block in blocks) & MASK
    return combine(total, sum(map(len, blocks)), blocks[-1].next_id)


def union_of(blocks: Sequence[State]) -> State:
    """The Gaussians of all blocks as one state, block after block; their ids rise."""
    joined = {
        name: read_only(np.concatenate([getattr(block, name) for block in blocks]))
        for name in (*ARRAYS, "ids", "hashes")
    }
    return State(**joined, next_id=blocks[-1].next_id, frame=blocks[0].frame)


def same_blocks(first: Sequence[State], second: Sequence[State]) -> bool:
    """Whether both are one scene at two times, as `same_scene`."""
    return all(map(same_scene, first, second))


def refine(
    before: Sequence[State] | None,
    base: Packet,
    refinements: Sequence[Refinement | None],
    header: StreamHeader,
    *,
    first: FirstKeyframe | None = None,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
) -> LayeredScene:
    """The frame of a ``base`` packet, read from behind its corrections, and of the ``refinements`` of each layer above.

    ``before``: the blocks of the frame before, None at a keyframe. ``first``: the first keyframe, for those that refer
    to it. Where the base's packet is a SKIP and no layer has a refinement, nothing
    changes; otherwise none may lack. The digest of all blocks together is compared. Raises StreamError.
    """
    there = [each for each in refinements if each is not None]
    if before is not None and base.kind == PacketKind.SKIP and not there:
        return LayeredScene(tuple(replace(block, frame=base.frame) for block in before), Changes(0, 0, 0))
    if len(there) < len(refinements):
        _refuse(base, Reason.MISSING_KEY, f"frame {base.frame} lacks its refinement")
    blocks, counts, room = list[State](), list[Changes](), max_gaussians
    for number, packet in enumerate([base, *(each.block for each in there)]):
        known = None if first is None else first.own[number]
        block, changes = _advanced(None if before is None else before[number], packet, header, known, room)
        if first is not None and number < len(refinements) and refers_to_first(packet):
            block = _as_in_first(block, first.own[number], first.aligned[number])
        if number:
            _check_ids(block, number, packet)
        blocks.append(block)
        counts.append(changes)
        room -= len(block)
    top = there[-1]
    blocks = [_aligned(block, packet) for block, packet in zip(blocks, (*top.alignments, None), strict=True)]
    if union_digest(blocks) != top.digest:
        _refuse(top.block, Reason.DIGEST_MISMATCH, "the layers together are not the encoder's")
    return LayeredScene(tuple(blocks), Changes(*(sum(each) for each in zip(*map(_numbers, counts), strict=True))))


def _advanced(
    state: State | None, packet: Packet, header: StreamHeader, first: State | None, max_gaussians: int
) -> tuple[State, Changes]:
    """A block after a packet of its own; other than a keyframe's, its digest is of values that only its layer has."""
    if state is None:
        payload = FramePayload({}, packet)
        return reconstruct_frame(None, payload, header, first=first, max_gaussians=max_gaussians)[:2]
    if packet.frame != state.frame + 1 or packet.kind == PacketKind.KEY:
        _refuse(packet, Reason.FRAME_ORDER, f"frame {packet.frame} follows frame {state.frame}")
    if packet.kind == PacketKind.SKIP:
        return replace(state, frame=packet.frame), Changes(0, 0, 0)
    delta, _ = read_delta(packet, state, max_gaussians)
    return apply_delta(state, delta), delta.changes


def _as_in_first(block: State, own: State, aligned: State) -> State:
    """A keyframe's block whose Gaussians that the first keyframe has are ``aligned`` as they were there."""
    here = np.isin(block.ids, own.ids, assume_unique=True)
    rows = np.searchsorted(own.ids, block.ids[here])
    was, is_now = take_rows(own, rows), take_rows(aligned, rows)
    values = {name: getattr(all_rows(block), name).copy() for name in ARRAYS}
    for name, array in values.items():
        array[here] += getattr(is_now, name) - getattr(was, name)
    return new_state(Attributes(**values), block.frame, ids=block.ids, next_id=block.next_id)


def _aligned(block: State, packet: Packet | None) -> State:
    """A lower block with the values that it has in the top layer."""
    if packet is None:
        return block
    delta, _ = read_delta(packet, block)
    if len(delta.removed) or len(delta.added):
        _refuse(packet, Reason.BAD_PAYLOAD, "an alignment adds or removes Gaussians")
    return replace(apply_delta(block, delta), frame=block.frame)


def _check_ids(block: State, number: int, packet: Packet) -> None:
    low, high = number * LAYER_IDS, (number + 1) * LAYER_IDS
    if not low <= block.next_id <= high or (len(block) and block.ids[0] < low):
        _refuse(packet, Reason.BAD_PAYLOAD, f"ids of layer {number} are another layer's")


def _numbers(changes: Changes) -> tuple[int, int, int]:
    return changes.touched, changes.added, changes.removed


def _refuse(packet: Packet, reason: str, message: str) -> NoReturn:
    raise StreamError(reason, message, packet=packet.ordinal, offset=packet.offset + PACKET_HEADER_SIZE)
