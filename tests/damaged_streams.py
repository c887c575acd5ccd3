"""Damage done to small streams, and what may be shown of them, whether they are opened or followed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.formats.stream.container import FRAME_KINDS, Packet

WHERE = {"sync": 0, "kind": 4, "frame": 8, "length": 12, "header crc": 16, "payload": 25}
"""Offsets in a packet, one in each thing that can be hit."""

EVERY = [pytest.param(1, id="every-byte", marks=pytest.mark.slow), pytest.param(5, id="every-fifth-byte")]
"""Steps from byte to byte. `make test` takes five, with every bit in turn, and does not see what only the others do."""


def frame_packet(packets: Sequence[Packet], frame: int) -> Packet:
    return next(p for p in packets if p.kind in FRAME_KINDS and p.frame == frame)


def flipped(path: Path, offset: int) -> None:
    data = bytearray(path.read_bytes())
    data[offset] ^= 4
    path.write_bytes(data)


def shown(frames: list, stream: Any) -> list[int]:
    """Which frame of the writer's each frame shows; its own index and place must be right in any case."""
    scenes = []
    for frame in frames:
        source = frame.index if frame.concealed is None else frame.concealed.held
        assert frame.state.row_sum == stream.states[source].row_sum
        assert np.array_equal(frame.state.means, stream.states[source].means)
        assert frame.state.frame == frame.index
        assert (frame.kind is None) == (frame.concealed is not None)
        scenes.append(source)
    assert [frame.index for frame in frames] == list(range(frames[0].index, frames[-1].index + 1))
    return scenes
