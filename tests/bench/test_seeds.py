"""Whole reports of several seeds on a tiny rig: keyframes by seed, going on, failures, and what the page says."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.commands import bench_parser
from decogs.bench.questions.variants import Question, Variant
from decogs.bench.reports.plans import Plan
from decogs.bench.reports.report import make_report
from decogs.bench.runs import rig_bench as runs
from decogs.bench.runs.run import BenchOptions
from decogs.formats.errors import TrainingError

pytestmark = pytest.mark.usefixtures("short_presets")

OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=1, seeds=(0, 1))
ROWS = (Variant("plain", "as it is"), Variant("few", "few steps", {"frame.joint_iterations": 3}))
PLAN = Plan("small", "A small report", (Question("steps", "Steps", "", ROWS, (("psnr", "psnr_dynamic"), ("cpu",))),))


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Names and seeds of the streams that get encoded."""
    made: list[tuple[str, int]] = []
    encode_stream = runs.encode_stream

    def observed(context: Any, output: Path, *arguments: Any) -> Any:
        made.append((output.name.split("-")[1], context.seed))
        return encode_stream(context, output, *arguments)

    monkeypatch.setattr(runs, "encode_stream", observed)
    return made


def test_a_report_of_two_seeds(
    three_frames: Path, tmp_path: Path, encoded: list[tuple[str, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    encode_stream = runs.encode_stream

    def stopped(context: Any, output: Path, *arguments: Any) -> Any:
        if (output.name.split("-")[1], context.seed) == ("few", 1):
            raise KeyboardInterrupt
        return encode_stream(context, output, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(runs, "encode_stream", stopped)
        with pytest.raises(KeyboardInterrupt):
            make_report(PLAN, [three_frames], tmp_path, OPTIONS)
    before = [("keyframe", 0), ("plain", 0), ("few", 0), ("keyframe", 1), ("plain", 1)]
    assert encoded == before, "seed by seed, each from its own keyframe"
    text = make_report(PLAN, [three_frames], tmp_path, OPTIONS, only=["none"]).read_text()
    assert len(re.findall(r"^\| few steps \| .*`three-few-[0-9a-f]{10}` \(1 of 2 seeds\) \|$", text, re.M)) == 2
    assert "| few steps | +" in text or "| few steps | -" in text, "of the seed that is there"

    path = make_report(PLAN, [three_frames], tmp_path, OPTIONS)
    assert encoded[len(before) :] == [("keyframe", 1), ("few", 1)], "the report without runs removed the streams"
    assert not (tmp_path / "streams").exists()
    text = path.read_text()
    assert "of 2 seeds" not in text
    assert "Figures are means over the seeds 0, 1, ±" in text
    assert "One run for each row" not in text
    row = r"^\| as it is \(the preset\) \| \d+\.\d\d ± \d+\.\d\d \| .*`three-plain-\{[0-9a-f]{10},[0-9a-f]{10}\}` \|$"
    assert len(re.findall(row, text, re.M)) == 2

    document = json.loads((tmp_path / "small.json").read_text())["rigs"]["three"]
    plain, few = document["questions"]["steps"]
    assert document["seeds"] == [0, 1]
    psnr = {
        row["variant"]: [
            sum(frame["psnr"] for frame in run["frames"]) / 3
            for run in (json.loads((tmp_path / file).read_text()) for file in row["runs"].values())
        ]
        for row in (plain, few)
    }
    assert plain["figures"]["psnr"] == pytest.approx(sum(psnr["plain"]) / 2)
    # Of two values: half of what they differ by.
    assert plain["figures"]["psnr_error"] == pytest.approx(abs(psnr["plain"][0] - psnr["plain"][1]) / 2)
    found = few["differences"]["psnr"]
    by_seed = [few - plain for few, plain in zip(psnr["few"], psnr["plain"], strict=True)]
    # Figures are kept to seven digits.
    assert list(found["seeds"].values()) == pytest.approx(by_seed, rel=1e-6)
    assert found["mean"] == pytest.approx(sum(by_seed) / 2, rel=1e-6)
    assert found["error"] == pytest.approx(abs(by_seed[0] - by_seed[1]) / 2, rel=1e-6)
    assert "differences" not in plain


def test_a_seed_that_cannot_be_trained_is_said_and_the_others_count(
    three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode_stream = runs.encode_stream

    def failing(context: Any, output: Path, *arguments: Any) -> Any:
        if "few" in output.name and context.seed == 0:
            raise TrainingError("the loss is nan")
        return encode_stream(context, output, *arguments)

    monkeypatch.setattr(runs, "encode_stream", failing)
    text = make_report(PLAN, [three_frames], tmp_path, OPTIONS).read_text()
    assert "few failed: seed 0: the loss is nan" in text
    assert text.count(" (1 of 2 seeds) |") == 2


@pytest.mark.parametrize(
    ("given", "seeds"),
    [([], [0, 1, 2]), (["--seeds", "2"], [0, 1]), (["--seeds", "0,3,7"], [0, 3, 7]), (["--seeds", "7,"], [7])],
)
def test_seeds_are_a_number_or_a_list(given: list[str], seeds: list[int]) -> None:
    for kind in ("choices", "effects", "curve"):
        assert list(bench_parser().parse_args([kind, "rig", "-o", "out", *given]).seeds) == seeds


def test_papers_and_rates_have_one_seed_unless_asked() -> None:
    for kind in ("paper", "rates"):
        assert list(bench_parser().parse_args([kind, "rig", "-o", "out"]).seeds) == [0]
    assert bench_parser().parse_args(["views", "rig", "-o", "out", "--seed", "7"]).seed == 7
