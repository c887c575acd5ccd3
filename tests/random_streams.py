"""Streams of random scenes, and what their floats are as a hash."""

from __future__ import annotations

import hashlib
import io
from dataclasses import replace

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, dequantise
from decogs.codec.scene.state import ARRAYS, Attributes
from decogs.decoder.reading.frame import DecodedFrame
from decogs.formats.cameras import Camera
from decogs.formats.stream.container import PacketKind, StreamWriter


def some_attributes(rng: np.random.Generator, count: int, degree: int) -> Attributes:
    def draw(*shape: int) -> np.ndarray:
        return rng.normal(0, 10 ** rng.uniform(0, 5), (count, *shape)).astype(np.int32)

    return Attributes(draw(3), draw(3), draw(4), draw(), draw((degree + 1) ** 2, 3))


def random_stream(seed: int, frames: int = 12, segment: int = 4) -> bytes:
    """Random scenes through the writer's own choices; segments refer to the first keyframe in turns."""
    rng, degree = np.random.default_rng(seed), seed % 4
    camera = Camera("a", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    header = StreamHeader(cameras=(camera,), lattice=default_lattice(4.0), sh_degree=degree)
    file = io.BytesIO()
    writer = StreamWriter(file, header.to_bytes())
    state, _ = keyframe_state(some_attributes(rng, 300, degree))
    first = state
    writer.write(PacketKind.KEY, 0, write_key(state).payload)
    for frame in range(1, frames):
        if frame % 4 == 2:
            state = replace(state, frame=frame)
            writer.write(PacketKind.SKIP, frame, write_skip(state).payload)
            continue
        rows, removed = (np.sort(rng.permutation(len(state))[: rng.integers(0, top)]) for top in (len(state), 40))
        added = some_attributes(rng, int(rng.integers(0, 60)), degree)
        delta = difference(state, rows, some_attributes(rng, len(rows), degree), removed=removed, added=added)
        payload = write_delta(state, delta, level=3).payload
        state = apply_delta(state, delta)
        if frame % segment == 0:
            refers = frame % (2 * segment) != 0
            writer.write(PacketKind.KEY, frame, write_key(state, first=first if refers else None).payload)
        else:
            writer.write(PacketKind.DELTA, frame, payload)
    writer.finish()
    return file.getvalue()


def floats_of(frame: DecodedFrame, header: StreamHeader) -> str:
    """As tests/conformance/README.md has it."""
    splats = dequantise(frame.state, header.lattice)
    shown = [getattr(splats, name).reshape(len(frame.state), -1) for name in ARRAYS] if len(frame.state) else []
    data = np.concatenate(shown, axis=1, dtype="<f4").tobytes() if shown else b""
    return hashlib.sha256(data).hexdigest()
