"""The report of what accuracy costs, on a tiny rig: its tables, and the picture with the front."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import cv2
import pytest

from decogs.bench.questions.variants import Question, Variant
from decogs.bench.reports.plans import Plan
from decogs.bench.reports.report import make_report
from decogs.bench.runs import rig_bench
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import BenchOptions

pytestmark = [
    pytest.mark.usefixtures("short_presets"),
    pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="plots need the extra 'bench'"),
]

OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=1)
OWN = Variant("own", "own </script> & <b>", own_keyframe=True)
SMALL = Variant("small", "half", scale=0.5, own_keyframe=True)
SHARED = Variant("preset", "the preset")
COLUMNS = (("psnr", "cpu", "decode_fps"),)
PLAN = Plan(
    "curve",
    "A small <curve>",
    (
        Question("kinds", "Kinds", "", (OWN, SMALL), COLUMNS),
        Question("steps", "Steps", "", (SHARED, Variant("few", "few", {"frame.joint_iterations": 3})), COLUMNS),
    ),
    front=True,
)


def test_the_whole_report(three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: dict[str, int] = {}
    encode = rig_bench.encode_stream

    def observed(context: Any, output: Path, span: range, options: Any) -> Any:
        sizes[output.name.split("-")[1]] = context.ingest.views[0].pinhole.width
        return encode(context, output, span, options)

    monkeypatch.setattr(rig_bench, "encode_stream", observed)
    path = make_report(PLAN, [three_frames], tmp_path, OPTIONS, command="decogs-bench curve <three>")
    assert sizes == {"keyframe": 64, "own": 64, "small": 32, "preset": 64, "few": 64}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curve.json", "curve.md", "pictures", "runs", "tables"]
    text = path.read_text()
    assert "### What is best for its price\n" in text
    (link,) = re.findall(r"\]\(([^)]+)\)", text)
    assert link == "pictures/three-curve-psnr-dynamic.png", "by which report/curve.md shows it"
    assert cv2.imread(str(tmp_path / link)).std() > 10, "something is drawn"

    bench = RigBench(three_frames, tmp_path, OPTIONS)
    small, own = bench.find(SMALL), bench.find(OWN)
    assert small is not None
    assert own is not None
    assert "--scale 0.5" in small.command
    assert "--scale" not in own.command
    assert small.scale == own.scale == 1, "measured at the same size"
    assert bench.key(OWN) != bench.key(SMALL)


def test_nothing_is_run_for_none_and_the_page_says_so(three_frames: Path, tmp_path: Path) -> None:
    text = make_report(PLAN, [three_frames], tmp_path, OPTIONS, only=["none"]).read_text()
    assert text.count("| not run |") == 4
    assert "best for its price" not in text
