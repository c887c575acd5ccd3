"""The player shows a stream in layers: all of them where they are there and wanted, the base otherwise."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.formats.stream.container import FRAME_KINDS, PacketKind
from layered_streams import layered
from node_player import missing_for_player, run_player_tests
from packets import iterate_packets
from random_streams import floats_of, random_stream

pytestmark = pytest.mark.skipif(
    missing_for_player() is not None, reason=f"the player's tests need {missing_for_player()}"
)


def floats(path: Path, layer: str) -> list[str]:
    with open_stream(path, layer=layer) as stream:
        return [floats_of(frame, stream.header) for frame in stream.frames()]


def test_which_layer_is_shown_and_when(tmp_path: Path) -> None:
    (tmp_path / "single.dgs").write_bytes(random_stream(3, frames=8, segment=100))
    stream = layered(tmp_path / "single.dgs", tmp_path / "layered.dgs")
    with stream.open("rb") as file:
        packets = list(iterate_packets(file))
    assert [packet.kind for packet in packets].count(PacketKind.KEY) == 1
    refinements = [packet for packet in packets if packet.kind == PacketKind.REFINE]
    frames = [packet for packet in packets if packet.kind in FRAME_KINDS]
    data = bytearray(stream.read_bytes())
    hit = refinements[2]
    data[hit.offset + 24] ^= 1
    (tmp_path / "damaged.dgs").write_bytes(data)
    facts = {
        "whole": floats(stream, "all"),
        "base": floats(stream, "base"),
        "refinements": frames[-1].offset + frames[-1].size,
        "end": refinements[-1].offset + refinements[-1].size,
        "damaged": hit.frame,
    }
    (tmp_path / "expected.json").write_text(json.dumps(facts))
    assert run_player_tests("layers.test", environment={"DECOGS_LAYERS": str(tmp_path)}) == 5
