"""The player shows what the Python decoder shows, bit for bit: of a stream that was encoded, and of damaged ones.

What Python makes of each stream is written beside it; ``player/tests/stream/python.test.ts`` then compares.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from damaged_streams import WHERE
from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, dequantise
from decogs.codec.scene.state import ARRAYS, Attributes
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import Stream, open_stream
from decogs.encoder import PRESETS
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, StreamWriter
from encode_rig import encode_rig as encode
from node_player import missing_for_player, run_player_tests
from packets import iterate_packets

REPOSITORY = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(
    missing_for_player() is not None, reason=f"the player's tests need {missing_for_player()}"
)


def some_attributes(rng: np.random.Generator, count: int, degree: int) -> Attributes:
    def draw(*shape: int) -> np.ndarray:
        return rng.normal(0, 10 ** rng.uniform(0, 5), (count, *shape)).astype(np.int32)

    return Attributes(draw(3), draw(3), draw(4), draw(), draw((degree + 1) ** 2, 3))


def random_stream(seed: int, frames: int = 12) -> bytes:
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
        if frame % 4 == 0:
            writer.write(PacketKind.KEY, frame, write_key(state, first=first if frame % 8 else None).payload)
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


def expected(path: Path) -> dict[str, Any]:
    """What Python shows of each frame when it is sought by itself; None where there is nothing to show."""
    try:
        with open_stream(path, on_damage=lambda damage: None) as stream:
            return {"frames": [one_frame(stream, index) for index in range(stream.frame_count)]}
    except StreamError as error:
        return {"error": error.reason}


def one_frame(stream: Stream, index: int) -> dict[str, Any] | None:
    try:
        frame = next(stream.frames(index, index + 1))
    except StreamError:
        return None
    return {"floats": floats_of(frame, stream.header), "damaged": frame.concealed is not None}


def damaged(data: bytes) -> Iterator[tuple[str, bytes]]:
    """One thing hit at a time, in a stream with index and in one that stops behind its last frame."""
    packets = list(iterate_packets(io.BytesIO(data)))
    last = next(packet for packet in packets if packet.kind == PacketKind.INDEX).offset
    for name, whole in (("indexed", data), ("open", data[:last])):
        for packet in packets:
            if packet.kind not in FRAME_KINDS:
                continue
            at, end = packet.offset, packet.offset + packet.size
            for place, inside in WHERE.items():
                hit = bytearray(whole)
                hit[at + inside] ^= 4
                yield f"{name}-{packet.frame}-{place}", bytes(hit)
            yield f"{name}-{packet.frame}-gone", whole[:at] + whole[end:]
            yield f"{name}-{packet.frame}-twice", whole[:end] + whole[at:]
            yield f"{name}-{packet.frame}-ten-bytes-gone", whole[: at + 25] + whole[at + 35 :]
            yield f"{name}-{packet.frame}-bytes-before", whole[:at] + b"DGSP!" + whole[at:]
            yield f"{name}-{packet.frame}-cut", whole[: at + 25]


def compare(folder: Path, streams: dict[str, bytes], intact: bytes | None = None) -> None:
    """``intact``: the stream that all of them were before they were damaged."""
    for name, data in streams.items():
        (folder / f"{name}.dgs").write_bytes(data)
    cases = {name: expected(folder / f"{name}.dgs") for name in streams}
    if intact is not None:
        (folder / "intact.dgs").write_bytes(intact)
        frames = [frame["floats"] for frame in expected(folder / "intact.dgs")["frames"]]
        cases = {name: case | {"intact": frames} for name, case in cases.items()}
    (folder / "expected.json").write_text(json.dumps(cases))
    assert run_player_tests("python.test", environment={"DECOGS_SAME_AS_PYTHON": str(folder)}) == len(streams)


def test_an_encoded_stream(tmp_path: Path) -> None:
    """The sample rig, small; the third frame is a keyframe that refers to the first."""
    live = PRESETS["live"]
    few = replace(live, keyframe=replace(live.keyframe, iterations=60, settle_iterations=30, cap=800))
    path = tmp_path / "encoded.dgs"
    encode(REPOSITORY / "tests" / "demo" / "workbench", path, few, frames=slice(3), scale=0.1, segment=2)
    compare(tmp_path, {"encoded": path.read_bytes()})


def test_random_streams(tmp_path: Path) -> None:
    compare(tmp_path, {f"random-{seed}": random_stream(seed) for seed in range(8)})


def test_damaged_streams(tmp_path: Path) -> None:
    stream = random_stream(1, frames=11)
    compare(tmp_path, dict(damaged(stream)), stream)
