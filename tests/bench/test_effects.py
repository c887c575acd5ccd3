"""The report on effects: as called for, none, one wrongly left out, and what a scene loses by that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from decogs.bench.questions import effects
from decogs.bench.reports.report import EFFECTS, make_report
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import BenchOptions

pytestmark = pytest.mark.usefixtures("short_presets")

OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=2)


@pytest.mark.slow
def test_what_is_wrongly_left_out_is_measured_and_what_is_not_called_for_is_not(
    three_frames: Path, tmp_path: Path
) -> None:
    rows = (effects.AUTO, effects.NONE, effects.WITHOUT["camera_shake"])
    plan = replace(EFFECTS, questions=(replace(EFFECTS.questions[0], variants=rows),))
    text = make_report(plan, [three_frames], tmp_path, OPTIONS).read_text()
    bench = RigBench(three_frames, tmp_path, OPTIONS)
    assert bench.key(effects.WITHOUT["camera_shake"]) == bench.key(effects.AUTO), "nothing shakes"
    assert bench.key(effects.NONE) != bench.key(effects.AUTO)
    assert "| camera_shake | not detected |" in text
    still = bench.find(effects.NONE)
    assert still is not None
    assert {frame.kind for frame in still.frames[1:]} == {"skip"}
    assert "--effects none" in still.command
    assert all(frame.psnr_aligned is not None for frame in still.frames)
