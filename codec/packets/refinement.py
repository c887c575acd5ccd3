"""The payload of a REFINE packet: what one layer of a frame adds to the layers below it (SPEC.md, "Layers")."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from decogs.formats.stream.container import FRAME_KINDS, Packet, PacketKind
from decogs.formats.stream.reasons import Reason

LAYER_IDS = 1 << 50
"""The Gaussians of layer k have ids from k times this on, so that no two of a frame have one id."""

MAX_LAYERS = 4
"""The base among them."""

_HEAD = struct.Struct("<BBHQ")
_LENGTH = struct.Struct("<I")


class Refinement(NamedTuple):
    """One layer of a frame. ``digest``: that of its Gaussians and those of all layers below, together.

    ``alignments``: of each layer below, the packet that takes its Gaussians to the values which they have here, None
    where they have them already. ``block``: the layer's own Gaussians, a KEY, DELTA or SKIP packet.
    """

    layer: int
    digest: int
    alignments: tuple[Packet | None, ...]
    block: Packet


def write_refinement(digest: int, alignments: Sequence[bytes], kind: PacketKind, block: bytes) -> bytes:
    """The payload of a layer above so many others as there are ``alignments``, bodies of DELTA packets or nothing."""
    parts = [_HEAD.pack(len(alignments), kind, 0, digest)]
    for body in alignments:
        parts += [_LENGTH.pack(len(body)), body]
    return b"".join([*parts, block])


def read_refinement(packet: Packet) -> Refinement:
    """The parts of a REFINE packet; raises StreamError."""
    cursor = packet.cursor()
    layer, kind, reserved, declared = _HEAD.unpack(cursor.take(_HEAD.size))
    if not 0 < layer < MAX_LAYERS or kind not in FRAME_KINDS or reserved:
        cursor.fail(Reason.BAD_PAYLOAD, f"a refinement of layer {layer} with a block of kind {kind} is not possible")
    alignments = []
    for _ in range(layer):
        body = bytes(cursor.take(cursor.u32()))
        alignments.append(replace(packet, kind=PacketKind.DELTA, payload=body, start=0) if body else None)
    block = replace(packet, kind=kind, start=cursor.position)
    return Refinement(layer, declared, tuple(alignments), block)
