"""Streams and scenes of the editing tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.state import ARRAYS, State
from decogs.decoder.reading.stream import open_stream
from decogs.formats.stream.container import PacketKind
from packets import iterate_packets


def states_of(path: Path) -> list[State]:
    with open_stream(path, strict=True) as stream:
        return [frame.state for frame in stream.frames()]


def header_of(path: Path) -> StreamHeader:
    with path.open("rb") as file:
        return StreamHeader.from_bytes(next(iterate_packets(file)).payload)


def assert_same_scenes(found: list[State], expected: list[State]) -> None:
    """The same Gaussians under the same ids."""
    assert_same_values(found, expected)
    for one, other in zip(found, expected, strict=True):
        assert one.next_id == other.next_id
        np.testing.assert_array_equal(one.ids, other.ids)


def assert_same_values(found: list[State], expected: list[State]) -> None:
    """The same Gaussians in the same order, whatever their ids."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def in_order_of_values(state: State) -> list[tuple[bytes, int]]:
    """Every Gaussian's values, which in these streams no other one has, and its id."""
    columns = [getattr(state, name).reshape(len(state), -1).astype("<i4") for name in ARRAYS]
    rows = np.concatenate(columns, axis=1)
    found = sorted((row.tobytes(), int(name)) for row, name in zip(rows, state.ids, strict=True))
    assert len({values for values, _ in found}) == len(found)
    return found


def bodies(path: Path) -> list[tuple[int, bytes]]:
    """Kind and payload of every frame's packet."""
    kinds = (PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP)
    with path.open("rb") as file:
        return [(packet.kind, packet.payload) for packet in iterate_packets(file) if packet.kind in kinds]
