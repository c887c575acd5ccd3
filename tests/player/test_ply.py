"""What the player gives as .ply is what decogs-export writes, in the world that the stream is shown in."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from decogs.codec.header.presentation import Presentation
from decogs.decoder.commands import export_main
from node_player import missing_for_player, run_player_tests

DATA = runpy.run_path(str(Path(__file__).with_name("browser_data.py")))


@pytest.mark.skipif(missing_for_player() is not None, reason=f"the player's unit tests need {missing_for_player()}")
def test_frames_as_ply(tmp_path: Path) -> None:
    cases = [(degree, shown) for degree in range(4) for shown in (Presentation(), DATA["SHOWN"])]
    for number, (degree, shown) in enumerate(cases):
        stream = tmp_path / f"{number}.dgs"
        DATA["write_stream"](stream, 300, degree, 4, presentation=shown)
        options = ["-q", "--frames", "2:3", "--up", "none", "-o", str(stream.with_suffix(".ply"))]
        assert export_main([str(stream), *options]) == 0
    assert run_player_tests("ply.test", environment={"DECOGS_PLY": str(tmp_path)}) == len(cases)
