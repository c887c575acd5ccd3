"""Layers of the plain decoder (sections 6, "Refinement packet", and 7, "Layers"): frames with all that refines them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from plain_container import DELTA, FRAME_KINDS, HEADER, KEY, REFINE, SKIP, Fields, Limits, Packet, packets, refuse
from plain_header import Header, read_header
from plain_payload import corrections, delta, key
from plain_state import State, digest, wrapped

IDS_OF_A_LAYER = 1 << 50


class Refinement:
    """The fields of a REFINE packet."""

    def __init__(self, packet: Packet, layers: int) -> None:
        fields = Fields(packet.payload)
        self.layer, self.kind = fields.u8(), fields.u8()
        if not 1 <= self.layer < layers or self.kind not in FRAME_KINDS or fields.take(2) != b"\0\0":
            refuse("bad-payload")
        self.digest = fields.u64()
        bodies = [fields.take(fields.u32()) for _ in range(self.layer)]
        self.alignments = [replace(packet, kind=DELTA, payload=body) if body else None for body in bodies]
        self.block = replace(packet, kind=self.kind, payload=packet.payload[fields.position :])


def decode_layers(data: bytes, top: int = 1) -> Iterator[list[State]]:
    """The blocks 0 to `top` of each frame of an undamaged stream. Raises Broken."""
    limits, header = Limits(), None
    frames: list[Packet] = []
    told: dict[int, list[Packet]] = {}
    for packet in packets(data, limits):
        if packet.kind == HEADER:
            header = read_header(packet.payload)
        elif packet.kind in FRAME_KINDS:
            frames.append(packet)
        elif packet.kind == REFINE:
            told.setdefault(packet.frame, []).append(packet)
    assert header is not None
    shown: list[State] | None = None
    first: tuple[list[State], list[State]] | None = None
    for packet in frames:
        _, body = corrections(packet, header)
        known = {each.layer: each for each in [Refinement(each, header.layers) for each in told.get(packet.frame, [])]}
        refinements = [known.get(layer) for layer in range(1, top + 1)]
        shown, own = frame(body, refinements, header, shown, first, limits)
        first = first or (own, shown)
        yield shown


def frame(
    packet: Packet,
    refinements: Sequence[Refinement | None],
    header: Header,
    before: list[State] | None,
    first: tuple[list[State], list[State]] | None,
    limits: Limits,
) -> tuple[list[State], list[State]]:
    """The blocks of a frame, and the same before they are aligned. `first`: both, of the first keyframe."""
    if packet.kind == SKIP and not any(refinements):
        assert before is not None
        unchanged = [replace(block, frame=packet.frame) for block in before]
        return unchanged, unchanged
    if not all(refinements):
        refuse("missing-key")
    own = []
    for layer, each in enumerate([packet, *(refinement.block for refinement in refinements if refinement)]):
        if each.kind == KEY and packet.kind != KEY:
            refuse("frame-order")
        own.append(block(each, layer, header, before, first[0] if first else None, limits))
        if not layer * IDS_OF_A_LAYER <= own[-1].next_id <= (layer + 1) * IDS_OF_A_LAYER:
            refuse("bad-payload")
    top = refinements[-1]
    assert top is not None
    aligned = list(own)
    for layer, each in enumerate([packet, *(refinement.block for refinement in refinements[:-1] if refinement)]):
        if first and each.kind == KEY and refers(each):
            aligned[layer] = as_in_first(own[layer], first[0][layer], first[1][layer])
    for layer, change in enumerate(top.alignments):
        if change is not None:
            _, state = delta(change, header, aligned[layer], limits)
            if state.ids != own[layer].ids:
                refuse("bad-payload")
            aligned[layer] = replace(state, frame=packet.frame)
    if digest(joined(aligned), sum(header.channels)) != top.digest:
        refuse("digest-mismatch")
    return aligned, own


def refers(packet: Packet) -> bool:
    """Whether a KEY refers to the first one: its reference lies behind digest, next id and number of Gaussians."""
    return packet.payload[20] == 1


def as_in_first(block: State, own: State, shown: State) -> State:
    """The block of a KEY, each Gaussian of the first keyframe `shown` as far from its `own` values as there."""
    by = {
        name: [after - before for before, after in zip(*rows, strict=True)]
        for name, rows in zip(own.ids, zip(own.rows, shown.rows, strict=True), strict=True)
    }
    moved = [
        [wrapped(value + step) for value, step in zip(row, by.get(name, [0] * len(row)), strict=True)]
        for name, row in zip(block.ids, block.rows, strict=True)
    ]
    return replace(block, rows=moved)


def joined(blocks: Sequence[State]) -> State:
    """The Gaussians of all blocks."""
    rows = [row for each in blocks for row in each.rows]
    return State(blocks[0].frame, blocks[-1].next_id, [name for each in blocks for name in each.ids], rows)


def block(
    packet: Packet, layer: int, header: Header, before: list[State] | None, first: list[State] | None, limits: Limits
) -> State:
    if packet.kind == KEY:
        told, state = key(packet, header, first[layer] if first else None, limits)
        if digest(state, sum(header.channels)) != told:
            refuse("digest-mismatch")
        return state
    if before is None:
        refuse("missing-key")
    if packet.kind == DELTA:
        return replace(delta(packet, header, before[layer], limits)[1], frame=packet.frame)
    return replace(before[layer], frame=packet.frame)
