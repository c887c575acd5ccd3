"""Runs as points between cost and quality, and the fronts among them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.estimates import Estimate
from decogs.bench.questions.curve import PRESET_ROWS, QUESTIONS
from decogs.bench.questions.variants import Question, Variant, settings_of
from decogs.bench.reports.trade import COSTS, QUALITY, Axis, Point, find_front, points_of, shown_range
from decogs.bench.runs.results import RigResults
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import BenchOptions
from decogs.encoder.settings.presets import LADDER

CPU, SIZE, FPS = COSTS


def at(cost: float | None, quality: float | None, axis: Axis = CPU, family: str = "family") -> Point:
    figures = {axis.key: cost, QUALITY.key: quality}
    return Point(family, "", {key: None if value is None else Estimate(value) for key, value in figures.items()})


def test_the_front_leaves_out_what_another_point_beats() -> None:
    points = [at(4.0, 31.0), at(1.0, 28.0), at(2.0, 27.5), at(2.0, 30.0), at(8.0, 31.0), at(None, 40.0), at(0.1, None)]
    assert find_front(points, CPU) == [points[1], points[3], points[0]]


def test_of_the_same_price_the_better_and_of_the_same_point_the_first() -> None:
    points = [at(1.0, 28.0), at(1.0, 29.0), at(1.0, 29.0, family="other")]
    assert find_front(points, CPU) == [points[1]]


def test_more_frames_a_second_are_cheaper() -> None:
    points = [at(10.0, 31.0, FPS), at(40.0, 28.0, FPS), at(5.0, 30.0, FPS)]
    assert find_front(points, FPS) == [points[1], points[0]]


def test_a_plot_is_not_pressed_together_by_what_is_far_below() -> None:
    points = [at(1.0, 26.0), at(2.0, 28.0), at(1.0, 17.0, family="other")]
    assert shown_range(points) == pytest.approx((25.6, 28.2))
    assert shown_range([at(1.0, None)]) == (0.0, 1.0)


@pytest.mark.usefixtures("short_presets")
def test_a_point_has_the_means_and_errors_of_its_runs(
    three_frames: Path, tmp_path: Path, run_of: Any, frame_of: Any
) -> None:
    bench = RigBench(three_frames, tmp_path, BenchOptions(holdout=("cam02",), preset="tiny", threads=1, seeds=(0, 1)))
    several, once, missing = (
        Variant("a", "several"),
        Variant("b", "once", own_keyframe=True),
        Variant("c", "c", frames=2),
    )
    result = RigResults(bench)
    for variant, seed, cpu, decoding in ((several, 0, 2.0, 0.01), (several, 1, 3.0, 0.01), (once, 0, 3.0, None)):
        frames = [frame_of(0), frame_of(1, cpu_seconds=cpu)]
        key = bench.key(replace(variant, seed=seed))
        result.runs[key] = run_of(frames, key=key, variant=variant.name, decode_cpu_seconds=decoding)
    one, other = points_of((Question("q", "Q", "", (several, once, missing), ()),), result)
    assert (one.label, other.label, one.family) == ("several", "once", "q")
    # Of two values: half of what they differ by.
    assert (one.at(CPU), one.error(CPU)) == (2.5, pytest.approx(0.5))
    assert (other.at(CPU), other.error(CPU)) == (3.0, None)
    assert (one.at(SIZE), one.error(SIZE)) == (2.0, 0.0), "kB"
    assert one.at(FPS) == pytest.approx(100.0)
    assert other.at(FPS) is None, "an older run"


def test_the_reports_rows_are_encodes_that_can_be_made() -> None:
    variants = [variant for question in QUESTIONS for variant in question.variants]
    assert len({variant.name for variant in variants}) == len(variants)
    for variant in variants:
        settings_of(variant, "standard")
    assert [row.preset for row in PRESET_ROWS] == list(LADDER)
