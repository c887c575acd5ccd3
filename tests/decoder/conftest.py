"""A small stream with every kind of packet, written by the codec itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import Attributes, State, take_rows
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats
from decogs.formats.stream.container import Packet, PacketKind, StreamWriter
from packets import iterate_packets

KINDS = ("key", "delta", "skip", "delta", "key", "delta", "skip", "skip")


@dataclass(frozen=True)
class SmallStream:
    """A finished stream, the states it was written from, and what its deltas did (touched, added, removed)."""

    path: Path
    header: StreamHeader
    states: tuple[State, ...]
    kinds: tuple[str, ...]
    changes: tuple[tuple[int, int, int], ...]


def some_splats(count: int, seed: int = 3) -> Splats:
    """Coloured blobs about 2 units in front of the cameras, SH degree 1."""
    random = np.random.default_rng(seed)
    values = (
        random.uniform([-0.7, -0.5, 1.6], [0.7, 0.5, 2.6], (count, 3)),
        random.uniform(-3.2, -2.2, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(0, 4, count),
        random.normal(0, 0.4, (count, 4, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def some_cameras() -> tuple[Camera, ...]:
    """A pinhole, an OpenCV lens and a fisheye; sizes differ."""
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0, 0.2]
    return (
        Camera("cam00", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4)),
        Camera("cam01", 60, 44, 50.0, 51.0, 29.0, 23.0, pose, "opencv", (-0.25, 0.05, 0.001, -0.002)),
        Camera("wide", 50, 50, 30.0, 30.0, 25.0, 25.0, pose, "fisheye", (0.05, -0.01, 0.002, -0.001)),
    )


def moved(attributes: Attributes, by: int) -> Attributes:
    return replace(attributes, means=attributes.means + np.int32(by))


def write_stream(path: Path, *, finished: bool = True) -> SmallStream:
    """Two segments: keyframe, motion, nothing, births and deaths; then keyframe, motion, nothing, nothing."""
    scene = some_splats(60)
    lattice = default_lattice(2.0)
    header = StreamHeader(
        cameras=some_cameras(),
        lattice=lattice,
        sh_degree=1,
        fps=25.0,
        background=(0.2, 0.3, 0.4),
        held_out=("cam01",),
        effects=("motion",),
        source_text="made\x1b[31m up",
        licence="CC0",
        settings={"preset": "none"},
    )
    states: list[State] = []
    changes = []
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for frame, kind in enumerate(KINDS):
            if kind == "key":
                first = states[-1].next_id if states else 0
                start = states[-1] if states else quantise(scene, lattice)
                state, _ = keyframe_state(start, frame, first_id=first)
                payload, change = write_key(state).payload, (0, len(state), 0)
            elif kind == "skip":
                state, payload, change = replace(states[-1], frame=frame), write_skip(states[-1]).payload, (0, 0, 0)
            else:
                rows = np.arange(5, 15)
                births = frame == 3
                delta = difference(
                    states[-1],
                    rows,
                    moved(take_rows(states[-1], rows), 300),
                    removed=np.array([20, 21]) if births else None,
                    added=quantise(some_splats(4, seed=9), lattice) if births else None,
                )
                state = apply_delta(states[-1], delta)
                payload, change = write_delta(states[-1], delta).payload, (10, 4 * births, 2 * births)
            writer.write(PacketKind[kind.upper()], frame, payload)
            states.append(state)
            changes.append(change)
        if finished:
            writer.finish()
    return SmallStream(path, header, tuple(states), KINDS, tuple(changes))


SEGMENT = 5


def write_segments(path: Path) -> SmallStream:
    """Four segments of five frames, later keyframes coded as differences from the first; things move, come and go."""
    lattice = default_lattice(2.0)
    header = StreamHeader(cameras=some_cameras(), lattice=lattice, sh_degree=1, fps=25.0)
    first, _ = keyframe_state(quantise(some_splats(1600), lattice))
    states, kinds, random = [first], [], np.random.default_rng(5)
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for frame in range(4 * SEGMENT):
            if frame:
                rows = np.arange(20 * frame, 20 * frame + 800)
                current = take_rows(states[-1], rows)
                current = replace(current, means=current.means + random.integers(-90, 90, (800, 3), dtype=np.int32))
                young = quantise(some_splats(2, seed=frame), lattice) if frame % 3 == 0 else None
                delta = difference(states[-1], rows, current, removed=rows[:1], added=young)
                states.append(apply_delta(states[-1], delta))
            if frame % SEGMENT == 0:
                kind, coded = "key", write_key(states[-1], first=first if frame else None)
            else:
                kind, coded = "delta", write_delta(states[-2], delta)
            writer.write(PacketKind[kind.upper()], frame, coded.payload)
            kinds.append(kind)
        writer.finish()
    return SmallStream(path, header, tuple(states), tuple(kinds), ())


@pytest.fixture
def segmented_stream(tmp_path: Path) -> SmallStream:
    return write_segments(tmp_path / "segments.dgs")


@pytest.fixture
def small_stream(tmp_path: Path) -> SmallStream:
    return write_stream(tmp_path / "scene.dgs")


@pytest.fixture
def packets(small_stream: SmallStream) -> list[Packet]:
    """The small stream's: header, KEY 0, DELTA 1, SKIP 2, DELTA 3, KEY 4, DELTA 5, SKIP 6, SKIP 7, index, end."""
    with small_stream.path.open("rb") as file:
        return list(iterate_packets(file))


@pytest.fixture
def tiny_stream(tmp_path: Path) -> SmallStream:
    """Seven frames of three Gaussians in little more than a kilobyte, for trying every byte.

    The fourth and the sixth are keyframes; the sixth refers to the first.
    """
    lattice = default_lattice(2.0)
    header = StreamHeader(cameras=some_cameras()[:1], lattice=lattice)
    scene = quantise(some_splats(3), lattice)
    state, _ = keyframe_state(replace(scene, sh=scene.sh[:, :1].copy()))
    first = state
    states: list[State] = []
    kinds = ("key", "delta", "skip", "key", "delta", "key", "skip")
    path = tmp_path / "tiny.dgs"
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        for frame, kind in enumerate(kinds):
            if kind == "delta":
                delta = difference(state, np.array([1]), moved(take_rows(state, np.array([1])), 9))
                payload, state = write_delta(state, delta).payload, apply_delta(state, delta)
            else:
                state = replace(state, frame=frame)
                coded = write_key(state, first=first if frame == 5 else None) if kind == "key" else write_skip(state)
                payload = coded.payload
            writer.write(PacketKind[kind.upper()], frame, payload)
            states.append(state)
        writer.finish()
    return SmallStream(path, header, tuple(states), kinds, ())


@pytest.fixture
def unfinished_stream(tmp_path: Path) -> SmallStream:
    """The same without index and end packet, cut 3 bytes into the last frame's packet."""
    stream = write_stream(tmp_path / "cut.dgs", finished=False)
    data = stream.path.read_bytes()
    last = len(data) - data.rindex(b"DGSP")
    stream.path.write_bytes(data[: len(data) - last + 3])
    return stream
