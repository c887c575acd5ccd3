"""Means and errors over seeds, and rows compared seed by seed, from runs made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.estimates import Estimate, estimate, written
from decogs.bench.questions.variants import Question, Variant
from decogs.bench.reports.summaries import summarise_differences
from decogs.bench.runs.results import RigResults
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import KEYFRAME, BenchOptions
from decogs.bench.tables.columns import COLUMNS, figures
from decogs.bench.tables.differences import BYTES, CPU, MEASURES, MOVING, difference_table, differences

pytestmark = pytest.mark.usefixtures("short_presets")

PRESET = Variant("on", "on")
OFF = Variant("off", "off", {"frame.warm_start": 0.5})
SAME = Variant("same", "the same as on")
LONGER = Variant("longer", "longer", {"frame.warm_start": 0.25})
QUESTION = Question("q", "Question", "", (OFF, PRESET, SAME, LONGER), ())
OFFSETS = {0: 0.0, 1: 3.0, 7: -7.0}
"""What seeds differ by, dB: exact in binary, so that the difference of two PSNRs is."""

Filled = Callable[..., RigResults]


@pytest.fixture
def filled(three_frames: Path, tmp_path: Path, run_of: Any, frame_of: Any) -> Filled:
    """Results of three seeds: a row has its gain, dB (a mapping: seed by seed), over its seed's offset."""

    def make(gains: dict[str, Any]) -> RigResults:
        options = BenchOptions(holdout=("cam02",), preset="tiny", seeds=tuple(OFFSETS))
        result = RigResults(RigBench(three_frames, tmp_path, options))
        for variant in QUESTION.variants[:2] + QUESTION.variants[3:]:
            gain = gains.get(variant.name, {})
            for seed in gain if isinstance(gain, dict) else OFFSETS:
                more = gain[seed] if isinstance(gain, dict) else gain
                psnr = dict.fromkeys(("psnr", "psnr_dynamic", "psnr_static"), 30.0 + OFFSETS[seed] + more)
                count = 3 if variant is LONGER else 2
                cost = {"bytes": 1000 if variant is PRESET else 1100, "cpu_seconds": 4.0}
                key = result.bench.key(replace(variant, seed=seed))
                rows = [frame_of(index, **psnr, **cost) for index in range(count)]
                result.runs[key] = run_of(rows, variant=variant.name, key=key, seed=seed)
        return result

    return make


def test_a_mean_and_its_standard_error() -> None:
    found = estimate([1.0, None, 2.0, 4.0])
    assert found is not None
    assert found.mean == pytest.approx(7 / 3)
    # Deviations -4/3, -1/3, 5/3: (16 + 1 + 25) / 9 over n - 1 = 2, and that over n = 3.
    assert found.error == pytest.approx(math.sqrt(42 / 9 / 2 / 3))
    assert estimate([5.0]) == Estimate(5.0, None)
    assert estimate([None]) is None


def test_an_error_has_the_digits_of_its_figure() -> None:
    assert written(Estimate(31.4712, 0.0349), ".2f") == "31.47 ± 0.03"
    assert written(Estimate(0.25, 0.003), "+.1%") == "+25.0% ± 0.3%"
    assert written(Estimate(31.4712), "+.2f") == "+31.47"
    assert written(None, ".2f") == "–"


@pytest.mark.parametrize(
    ("figure", "clear"),
    [(Estimate(0.5, 0.24), True), (Estimate(-0.5, 0.24), True), (Estimate(0.5, 0.25), False), (Estimate(0.5), False)],
)
def test_clear_is_more_than_two_errors(figure: Estimate, clear: bool) -> None:
    assert figure.is_clear is clear


def test_what_seeds_have_in_common_drops_out(filled: Filled) -> None:
    result = filled({"on": 0.0, "off": 0.25})
    (found,) = differences(result, QUESTION)
    assert found.variant is OFF
    assert found.of(MOVING) == Estimate(0.25, 0.0), "the seeds differ by 10 dB"
    alone = COLUMNS["psnr_dynamic"].over(result.runs_of(OFF).values(), [])
    assert alone is not None
    assert alone.error == pytest.approx(math.sqrt(((4 / 3) ** 2 + (13 / 3) ** 2 + (17 / 3) ** 2) / 2 / 3))
    assert found.of(BYTES) == Estimate(pytest.approx(10.0), pytest.approx(0.0, abs=1e-12))
    assert found.of(CPU) == Estimate(0.0, 0.0)
    assert found.verdict() == "gains PSNR, dynamic, static, last frame; costs bytes"


def test_differences_that_seeds_disagree_on_are_not_marked(filled: Filled) -> None:
    (found,) = differences(filled({"on": 0.0, "off": {0: 0.5, 1: -0.25, 7: 0.25}}), QUESTION)
    difference = found.of(MOVING)
    assert difference is not None
    # Mean 1/6, deviations 1/3, -5/12, 1/12: (16 + 25 + 1) / 144 over 2, and that over 3.
    assert difference.mean == pytest.approx(1 / 6)
    assert difference.error == pytest.approx(math.sqrt(42 / 144 / 2 / 3))
    assert found.verdict() == "costs bytes"


def test_what_is_nothing_as_written_is_not_marked(filled: Filled) -> None:
    (found,) = differences(filled({"on": 0.0, "off": 2.0**-10}), QUESTION)
    assert MOVING.write(found.of(MOVING)) == "+0.00 ± 0.00"
    assert found.verdict() == "costs bytes"


def test_only_seeds_and_frames_that_both_have_are_compared(filled: Filled) -> None:
    result = filled({"on": {0: 0.0, 1: 0.0}, "off": {1: 0.5, 7: 9.0}, "longer": 1.0})
    (found,) = differences(result, QUESTION)
    assert (found.variant, found.by_seed["psnr"]) == (OFF, {1: 0.5})
    assert found.of(MOVING) == Estimate(0.5, None)
    assert found.verdict() == "–", "one seed cannot tell"


def test_no_table_without_something_to_compare(filled: Filled) -> None:
    assert difference_table(filled({"on": 0.0}), QUESTION) == []
    assert difference_table(filled({"off": 0.0}), QUESTION) == []
    assert difference_table(filled({"on": 0.0, "off": 0.0}), replace(QUESTION, variants=(OFF, LONGER))) == []


def test_a_question_may_name_the_row_that_others_are_compared_with(filled: Filled) -> None:
    result = filled({"on": 0.0, "off": 0.25})
    (found,) = differences(result, replace(QUESTION, variants=(OFF, PRESET), reference=OFF))
    assert (found.variant, found.of(MOVING)) == (PRESET, Estimate(-0.25, 0.0))


def test_the_table_and_the_summary(filled: Filled) -> None:
    result, none = filled({"on": 0.0, "off": {0: 0.25, 1: 0.5, 7: 0.75}}), filled({})
    lines = difference_table(result, QUESTION)
    assert lines[0] == "Differences to “on”, paired by seed:"
    # Deviations of a quarter: 1/4 / sqrt(3) = 0.144.
    assert [cell.strip() for cell in lines[4].split("|")[1:-1]] == [
        "off",
        *["+0.50 ± 0.14"] * 4,
        "+10.0 ± 0.0",
        "+0.0 ± 0.0",
        "gains PSNR, dynamic, static, last frame; costs bytes",
    ]
    summary = summarise_differences([replace(QUESTION, title="Before", variants=(LONGER,)), QUESTION], [result, none])
    assert summary[0] == "## Against the preset, over all rigs"
    (row,) = [line for line in summary if line.startswith("| Question")]
    assert row == "| Question: off | **+0.50 ± 0.14** | **+10.0 ± 0.0** | +0.0 ± 0.0 | – | – | – |"
    assert not any("Before" in line for line in summary), "nothing to compare it with"
    assert summarise_differences([QUESTION], [none]) == []


def test_a_slope_over_seeds_has_their_error(run_of: Any, frame_of: Any) -> None:
    runs = [run_of([frame_of(i, psnr=30.0 + slope * i) for i in range(4)]) for slope in (0.01, 0.02, 0.03)]
    # Slopes of 1, 2 and 3 dB per 100 frames: deviations of 1, 1 / sqrt(3).
    assert COLUMNS["slope"].value(runs, runs) == "+2.00 ± 0.58"
    assert figures(runs)["slope_error"] == pytest.approx(1 / math.sqrt(3))
    assert figures(runs)["psnr_error"] == pytest.approx(0.015 / math.sqrt(3)), "means 30.015, 30.03, 30.045"
    assert "psnr_error" not in figures(runs[:1])


def test_numbers_for_other_programs(filled: Filled) -> None:
    (found,) = differences(filled({"on": 0.0, "off": {0: 0.25, 1: 0.5, 7: 0.75}}), QUESTION)
    document = found.document()
    assert set(document) == {measure.key for measure in MEASURES}
    assert document["psnr_dynamic"] == {
        "mean": 0.5,
        "error": pytest.approx(0.25 / math.sqrt(3), rel=1e-6),
        "seeds": {0: 0.25, 1: 0.5, 7: 0.75},
    }


def test_a_seed_is_another_run_from_another_keyframe(three_frames: Path, tmp_path: Path) -> None:
    bench = RigBench(three_frames, tmp_path, BenchOptions(holdout=("cam02",), preset="tiny", seeds=(3, 0)))
    old = RigBench(three_frames, tmp_path, BenchOptions(holdout=("cam02",), preset="tiny"))
    first, second = bench.seeded([PRESET])
    assert bench.key(first) == bench.key(PRESET) != bench.key(second)
    assert bench.key(second) == old.key(PRESET), "a run of a report of one seed counts"
    assert len({bench.key(variant) for variant in bench.seeded([KEYFRAME])}) == 2
