"""Runs as points between cost and quality, and the fronts among them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from decogs.bench.questions.curve import PRESET_ROWS, QUESTIONS
from decogs.bench.questions.variants import Question, Variant, settings_of
from decogs.bench.reports.report import CURVE
from decogs.bench.reports.trade import COSTS, QUALITIES, Point, Step, front, points_of, shown_range
from decogs.bench.runs.results import Plan, RigResults
from decogs.bench.runs.rig_bench import KEYFRAME, BenchOptions, RigBench
from decogs.encoder.settings.presets import LADDER

CPU, FPS = (next(axis for axis in COSTS if axis.key == key) for key in ("cpu", "decode_fps"))
PSNR = next(axis for axis in QUALITIES if axis.key == "psnr")


def at(cost: float | None, quality: float | None, axis: str = "cpu") -> Point:
    return Point("family", "label", "variant", ["run"], "command", {axis: cost, "psnr": quality})


def test_the_front_leaves_out_what_another_point_beats() -> None:
    points = [at(4.0, 31.0), at(1.0, 28.0), at(2.0, 27.5), at(2.0, 30.0), at(8.0, 31.0), at(None, 40.0), at(0.1, None)]
    assert front(points, CPU, PSNR) == [Step(1, None), Step(3, 2.0), Step(0, 0.5)]


def test_of_the_same_price_the_better_and_of_the_same_point_the_first() -> None:
    points = [at(1.0, 28.0), at(1.0, 29.0), at(1.0, 29.0)]
    assert front(points, CPU, PSNR) == [Step(1, None)]


def test_more_frames_a_second_are_cheaper() -> None:
    points = [at(10.0, 31.0, "decode_fps"), at(40.0, 28.0, "decode_fps"), at(5.0, 30.0, "decode_fps")]
    assert front(points, FPS, PSNR) == [Step(1, None), Step(0, pytest.approx(0.1))], "dB per frame a second given up"


def test_a_plot_is_not_pressed_together_by_what_is_far_below() -> None:
    other = Point("other", "label", "variant", ["run"], "command", {"psnr": 17.0})
    points = [at(1.0, 26.0), at(2.0, 28.0), other]
    assert shown_range(points, PSNR) == pytest.approx((25.6, 28.2))
    assert shown_range([at(1.0, None)], PSNR) == (0.0, 1.0)


@pytest.mark.usefixtures("short_presets")
def test_a_point_has_the_figures_of_its_run_and_the_keyframe_it_began_with(
    three_frames: Path, tmp_path: Path, run_of: Any, frame_of: Any
) -> None:
    bench = RigBench(three_frames, tmp_path, BenchOptions(holdout=("cam02",), preset="tiny", threads=1))
    shared, own, missing = Variant("a", "shares"), Variant("b", "own", own_keyframe=True), Variant("c", "c", frames=2)
    plan = Plan("p", "P", (Question("q", "Q", "", (shared, own, missing), ()),))
    result = RigResults(bench)
    for variant, cpu, first in ((shared, 2.0, 0.1), (own, 3.0, 60.0), (KEYFRAME, 0.0, 50.0)):
        frames = [frame_of(0, cpu_seconds=first), frame_of(1, cpu_seconds=cpu, psnr=None)]
        key = bench.key(variant)
        result.runs[key] = run_of(frames, key=key, variant=variant.name, decode_cpu_seconds=0.01, stream_bytes=6000)
    one, other = points_of(plan, result)
    assert (one.label, other.label, one.family) == ("shares", "own", "q")
    assert (one.figures["cpu"], one.figures["keyframe_cpu"]) == (2.0, 50.0), "it did not pay for it, but needs it"
    assert (other.figures["cpu"], other.figures["keyframe_cpu"]) == (3.0, 60.0)
    assert one.figures["decode_fps"] == pytest.approx(100.0)
    assert (one.figures["kilobytes"], one.figures["kilobytes_all"]) == (2.0, 3.0)
    assert one.figures["psnr"] == 30.0
    result.runs[bench.key(shared)] = run_of([frame_of(0), frame_of(1)], key=bench.key(shared))
    assert points_of(plan, result)[0].figures["decode_fps"] is None, "an older run"
    del result.runs[bench.key(KEYFRAME)]
    assert points_of(plan, result)[0].figures["keyframe_cpu"] is None


def test_the_reports_rows_are_encodes_that_can_be_made() -> None:
    variants = [variant for question in QUESTIONS for variant in question.variants]
    assert len({variant.name for variant in variants}) == len(variants)
    for variant in variants:
        settings_of(variant, "standard")
    assert [row.preset for row in PRESET_ROWS] == list(LADDER)
    assert CURVE.trade is not None
    assert all(variant in variants for variant in CURVE.trade.followed)
