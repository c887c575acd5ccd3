"""Vectors of streams in layers (bitstream 1.1): good ones, and faults in what refines a base."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from plain_container import KEY, LAYERS, REFINE
from plain_layers import as_in_first
from plain_state import State, digest
from stream_writer import Stream, Vector, changed, prologue, scene

IDS_OF_A_LAYER = 1 << 50
Residuals = dict[int, Sequence[int]]
Call = Callable[[Stream], None]
"""Appends one frame to a block."""


def listed(layers: int) -> list[dict[str, Any]]:
    """The header's list."""
    entries: list[dict[str, Any]] = [{"gaussians": 9, "bytes_per_frame": 100.5, "psnr": 30.25} for _ in range(layers)]
    del entries[-1]["psnr"]
    return entries


class Layered:
    """A stream in layers under construction, and what a decoder must find in it with each layer.

    A layer has a stream of its own Gaussians, and one of each block below, as that block is in this layer; of these
    only states and single payloads are used.
    """

    def __init__(self, layers: int = 2, header: Mapping[str, Any] = MappingProxyType({})) -> None:
        self.base = Stream({**changed("layers", listed(layers)), **header}, prologue(1, 1))
        self.tops = [Stream() for _ in range(layers - 1)]
        self.below = [[Stream() for _ in range(layer)] for layer in range(1, layers)]
        self.unions: list[list[State]] = [[] for _ in self.tops]
        self.firsts: list[list[State]] = []
        self.pending: list[tuple[int, bytes]] = []
        self.refinements: list[tuple[int, int, int]] = []

    def frame(self, *calls: Call, aligned: dict[tuple[int, int], Residuals] | None = None, fault: Any = None) -> None:
        """One frame: a call for each block, and by layer and block below, by how much its values differ from now on.

        ``fault`` changes the parts of the payload of layer 1; None in place of them leaves the packet out.
        """
        number = len(self.base.frames)
        calls[0](self.base)
        for layer, (top, below) in enumerate(zip(self.tops, self.below, strict=True), start=1):
            alignments = []
            for block, stream in enumerate(below):
                calls[block](stream)
                if stream.frames[-1][2] == KEY and payload_of(stream)[20] == 1:
                    first = self.firsts[layer - 1][block]
                    stream.states[-1] = as_in_first(stream.states[-1], stream.states[0], first)
                residuals = (aligned or {}).get((layer, block))
                if residuals:
                    stream.delta(residuals)
                alignments.append(payload_of(stream) if residuals else b"")
            if not number:
                self.firsts.append([stream.states[-1] for stream in below])
            calls[layer](top)
            union = joined([*(stream.states[-1] for stream in below), top.states[-1]], number)
            self.unions[layer - 1].append(union)
            kind = top.frames[-1][2]
            parts = [layer, kind, 0, digest(union, self.base.width), alignments, payload_of(top)]
            parts = fault(parts) if fault is not None and layer == 1 else parts
            if parts is not None:
                self.pending.append((number, refinement(*parts)))

    def still(self) -> None:
        """A frame in which nothing changes, without refinements."""
        self.base.skip()
        for below, top, unions in zip(self.below, self.tops, self.unions, strict=True):
            for stream in (*below, top):
                stream.skip()
            unions.append(replace(unions[-1], frame=unions[-1].frame + 1))

    def end_segment(self) -> None:
        """What refines the frames so far."""
        for frame, payload in self.pending:
            self.base.add(REFINE, frame, payload, flags=0)
            self.refinements.append((self.base.offsets[-1], frame, payload[0]))
        self.pending = []

    def finish(self) -> None:
        self.end_segment()
        self.base.index()
        index = self.base.offsets[-1]
        entries = b"".join(struct.pack("<QIB3x", *entry) for entry in self.refinements)
        self.base.add(LAYERS, 0, struct.pack("<I", len(self.refinements)) + entries, flags=0)
        self.base.offsets.append(index)
        self.base.end()

    def vector(self, name: str, fault: tuple[str, int] | None = None) -> Vector:
        """``fault``: the reason with which layer 1 ends, and in which frame; the base does not."""
        self.finish()
        unions = [states if fault is None else states[: fault[1]] for states in self.unions]
        good = self.base.good(name, indexes=[True])
        return replace(good, layers=tuple(map(tuple, unions)), layer_fault=None if fault is None else fault[0])


def payload_of(stream: Stream) -> bytes:
    """Of the last packet."""
    return stream.data[stream.offsets[-1] + 20 : -4]


def refinement(layer: int, kind: int, reserved: int, told: int, alignments: Sequence[bytes], block: bytes) -> bytes:
    bodies = b"".join(struct.pack("<I", len(body)) + body for body in alignments)
    return struct.pack("<BBHQ", layer, kind, reserved, told) + bodies + block


def joined(blocks: Sequence[State], frame: int) -> State:
    rows = [row for block in blocks for row in block.rows]
    return State(frame, blocks[-1].next_id, [name for block in blocks for name in block.ids], rows)


def key(layer: int, seed: int, count: int, **told: Any) -> Call:
    def call(stream: Stream) -> None:
        first = layer * IDS_OF_A_LAYER
        stream.key(stream.state(scene(seed, count, stream.width), ids=range(first, first + count), **told))

    return call


def delta(residuals: Residuals | None = None, removed: Sequence[int] = (), added: Sequence[int] = ()) -> Call:
    """``added``: seeds of Gaussians that come."""

    def call(stream: Stream) -> None:
        stream.delta(residuals, removed, [scene(seed, 1, stream.width)[0] for seed in added])

    return call


def referring(layer: int, residuals: Residuals | None = None, removed: Sequence[int] = (), *, count: int) -> Call:
    """A keyframe as a change of the first one, which had so many Gaussians."""
    return lambda stream: stream.referring_key(residuals, removed, next_id=layer * IDS_OF_A_LAYER + count)


def skip(stream: Stream) -> None:
    stream.skip()


WIDTH = Stream().width


def row(seed: int) -> list[int]:
    return scene(seed, 1, WIDTH, 9)[0]


def moved(*rows: int, seed: int = 50) -> Residuals:
    return {number: row(seed + number) for number in rows}


def opened(layers: int = 2, header: Mapping[str, Any] = MappingProxyType({})) -> Layered:
    """With a keyframe whose base has values of its own."""
    stream = Layered(layers, header)
    calls = [key(layer, 10 + layer, 4 + layer) for layer in range(layers)]
    differs = {
        (layer, block): moved(0, 2, seed=60 + 10 * layer + block)
        for layer in range(1, layers)
        for block in range(layer)
    }
    stream.frame(*calls, aligned=differs)
    return stream


def good_layers() -> Iterator[Vector]:
    two = opened()
    two.frame(delta(moved(1, 3)), delta(moved(0)))
    two.still()
    two.frame(skip, delta(moved(2), removed=[1]))
    two.frame(delta(moved(2), removed=[0], added=[70]), skip, aligned={(1, 0): moved(3, seed=80)})
    two.frame(skip, skip, aligned={(1, 0): moved(1, seed=81)})
    two.end_segment()
    two.frame(referring(0, moved(3), count=4), referring(1, moved(1), removed=[2], count=5), aligned={(1, 0): moved(0)})
    two.frame(delta(moved(0, 1)), delta(added=[71, 72]))
    two.end_segment()
    two.frame(referring(0, moved(1), removed=[0], count=4), referring(1, count=5))
    two.end_segment()
    two.frame(referring(0, count=4), key(1, 82, 3))
    two.frame(skip, delta(moved(1)))
    yield two.vector("good/two-layers")
    three = opened(3)
    three.frame(delta(moved(1)), delta(moved(0), added=[73]), delta(removed=[4]), aligned={(2, 1): moved(5)})
    three.still()
    three.end_segment()
    three.frame(*(key(layer, 20 + layer, 3) for layer in range(3)), aligned={(1, 0): moved(1), (2, 0): moved(2)})
    yield three.vector("good/three-layers")
    empty = Layered()
    empty.frame(key(0, 1, 0, next_id=0), key(1, 1, 0, next_id=IDS_OF_A_LAYER))
    empty.frame(delta(added=[74]), delta(added=[75]))
    yield empty.vector("good/layers-without-gaussians")
    told = opened(header={"profiles": ["phone", "of a later version"]})
    told.frame(delta(moved(1)), skip)
    yield told.vector("good/layers-and-profiles")


def absent() -> Iterator[Vector]:
    """Lists out of bounds count as absent: refinements are then skipped."""
    unbound = {
        "one": listed(1),
        "five": listed(5),
        "no-list": {},
        "psnr-of-all": [listed(2)[0], listed(2)[0]],
        "no-psnr": [listed(2)[1], listed(2)[1]],
        "too-many-gaussians": [listed(2)[0], listed(2)[1] | {"gaussians": (1 << 27) + 1}],
        "half-a-gaussian": [listed(2)[0] | {"gaussians": 1.5}, listed(2)[1]],
        "negative-bytes": [listed(2)[0] | {"bytes_per_frame": -1}, listed(2)[1]],
    }
    for name, entries in unbound.items():
        stream = Layered(2, {"layers": entries})
        stream.frame(key(0, 1, 3), key(1, 2, 2))
        yield replace(stream.vector(f"good/layers-absent-{name}"), layers=())
    for name, said in {"too-many": ["phone", "phone"], "no-list": "phone", "number": [1], "long": ["x" * 33]}.items():
        stream = Stream(changed("profiles", said), prologue(1, 1))
        stream.key(stream.state(scene(1, 3, stream.width)))
        stream.finish()
        yield stream.good(f"good/profiles-absent-{name}", indexes=[True])


def with_part(place: int, value: Any) -> Callable[[list[Any]], list[Any]]:
    """The payload with another part in one place: layer, kind, reserved, digest, alignments, block."""
    return lambda parts: [*parts[:place], value(parts[place]) if callable(value) else value, *parts[place + 1 :]]


def of_change(**told: Any) -> bytes:
    """An alignment of the base of `opened` in its second frame."""
    stream = Stream()
    key(0, 10, 4)(stream)
    stream.delta(**told)
    return payload_of(stream)


def faults() -> Iterator[Vector]:
    """In the second frame's refinement, or the first's; the third is good again, and shows the base."""
    wrong = {
        "reserved-is-set": (with_part(2, 1), "bad-payload"),
        "of-the-base": (with_part(0, 0), "bad-payload"),
        "of-a-layer-beyond": (with_part(0, 2), "bad-payload"),
        "of-layer-four": (with_part(0, 4), "bad-payload"),
        "kind-is-none": (with_part(1, 5), "bad-payload"),
        "kind-is-key": (with_part(1, 2), "frame-order"),
        "is-not-there": (lambda parts: None, "missing-key"),
        "digest-is-anothers": (with_part(3, lambda told: told ^ 1), "digest-mismatch"),
        "alignment-adds": (with_part(4, [of_change(added=[row(1)])]), "bad-payload"),
        "alignment-removes": (with_part(4, [of_change(removed=[1])]), "bad-payload"),
        "alignment-has-bytes-behind": (with_part(4, [of_change(residuals=moved(1)) + b"\0"]), "bad-payload"),
        "alignment-is-too-long": (with_part(4, [bytes(1)]), "bad-payload"),
        "block-is-cut": (with_part(5, lambda block: block[:-1]), "bad-payload"),
        "block-has-bytes-behind": (with_part(5, lambda block: block + b"\0"), "bad-payload"),
        "block-is-not-there": (with_part(5, b""), "bad-payload"),
    }
    for name, (fault, reason) in wrong.items():
        stream = opened()
        stream.frame(delta(moved(1)), delta(moved(0)), fault=fault)
        stream.frame(delta(moved(2)), delta(moved(1)))
        yield stream.vector(f"damaged/refinement-{name}", (reason, 1))
    lacking = Layered()
    lacking.frame(key(0, 1, 3), key(1, 2, 2), fault=lambda parts: None)
    lacking.frame(delta(moved(1)), delta(moved(0)))
    yield lacking.vector("damaged/refinement-of-the-keyframe-is-not-there", ("missing-key", 0))
    for name, layer in {"below": 0, "above": 2}.items():
        stream = Layered()
        stream.frame(key(0, 1, 3), key(layer, 2, 2))
        yield stream.vector(f"damaged/refinement-has-ids-{name}", ("bad-payload", 0))


def layer_vectors() -> Iterator[Vector]:
    """All of them."""
    yield from good_layers()
    yield from absent()
    yield from faults()
