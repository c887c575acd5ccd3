"""The player shows what the Python decoder shows, bit for bit: of a stream that was encoded, and of damaged ones.

What Python makes of each stream is written beside it; ``player/tests/stream/python.test.ts`` then compares.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from damaged_streams import WHERE
from decogs.decoder.reading.stream import Stream, open_stream
from decogs.encoder import PRESETS
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import FRAME_KINDS, PacketKind
from encode_rig import encode_rig as encode
from layered_streams import layered
from node_player import missing_for_player, run_player_tests
from packets import iterate_packets
from random_streams import floats_of, random_stream

REPOSITORY = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(
    missing_for_player() is not None, reason=f"the player's tests need {missing_for_player()}"
)


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


def test_streams_in_layers(tmp_path: Path) -> None:
    """Forwards and backwards, with all layers; segments refer to the first keyframe in turns."""
    streams = {}
    for seed in range(4):
        (tmp_path / "single.dgs").write_bytes(random_stream(seed))
        streams[f"layers-{seed}"] = layered(tmp_path / "single.dgs", tmp_path / "layered.dgs", refreshed=6).read_bytes()
    compare(tmp_path, streams)


def test_damaged_streams(tmp_path: Path) -> None:
    stream = random_stream(1, frames=11)
    compare(tmp_path, dict(damaged(stream)), stream)
