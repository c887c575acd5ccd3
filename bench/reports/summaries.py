"""What a report says first, over all rigs."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimates import NOTHING, estimate
from ..questions import effects, paper
from ..questions.variants import Question, Variant
from ..runs.results import RigResults
from ..tables.columns import COLUMNS, markdown
from ..tables.differences import BYTES, CPU, MOVING, Differences, Measure, differences


def summarise_gains(results: Sequence[RigResults]) -> list[str]:
    """DecoGS against the baseline, rig by rig: what the paper claims, as ratios."""
    rows = [
        [result.bench.name, variant.description, *_comparison(result, variant)]
        for result in results
        for variant in (paper.DECOGS_AUTO, paper.DECOGS, paper.DECOGS_PAPER)
        if result.runs_of(variant) and result.runs_of(paper.BASELINE)
    ]
    if not rows:
        return []
    headings = [
        "rig", "method", "dynamic PSNR over the baseline's, dB", "mTV ×100 / baseline's", "CPU-s/frame / baseline's",
        "MB/frame / baseline's",
    ]  # fmt: skip
    return ["## DecoGS against the baseline", "", *markdown(headings, rows), ""]


def _comparison(result: RigResults, variant: Variant) -> list[str]:
    runs, baseline = result.runs_of(variant), result.runs_of(paper.BASELINE)
    gain = MOVING.write(estimate(MOVING.paired(runs, baseline).values()))
    ours, theirs = list(runs.values()), list(baseline.values())
    ratios = []
    for key in ("mtv", "cpu", "megabytes"):
        column = COLUMNS[key]
        a, b = column.over(ours, ours), column.over(theirs, theirs)
        ratios.append(NOTHING if a is None or b is None else _ratio(a.mean, b.mean, column.form))
    return [gain, *ratios]


def _ratio(a: float, b: float, form: str) -> str:
    return f"{a:{form}} / {b:{form}}" + (f" = 1/{b / a:.1f}" if a > 0 and b > 0 else "")


def summarise_differences(questions: Sequence[Question], results: Sequence[RigResults]) -> list[str]:
    """A summary of all questions: what each row has more or less than its reference, rig by rig; bold where clear."""
    shown = (MOVING, BYTES, CPU)
    rows = []
    for question in questions:
        by_rig = [{each.variant.name: each for each in differences(result, question)} for result in results]
        for variant in question.variants:
            cells = [_cell(rig.get(variant.name), measure) for rig in by_rig for measure in shown]
            if any(variant.name in rig for rig in by_rig):
                rows.append([f"{question.title}: {variant.description}", *cells])
    if not rows:
        return []
    headings = ["", *(f"{result.bench.name}: {measure.heading}" for result in results for measure in shown)]
    return [
        "## Against the preset, over all rigs",
        "",
        "Where things move, bytes and processor seconds of a later frame; paired by seed, bold beyond two standard "
        "errors.",
        "",
        *markdown(headings, rows),
        "",
    ]


def _cell(row: Differences | None, measure: Measure) -> str:
    difference = None if row is None else row.of(measure)
    text = measure.write(difference)
    return f"**{text}**" if measure.is_clear(difference) else text


def summarise_effects(results: Sequence[RigResults]) -> list[str]:
    """Scene by effect: what PSNR loses without an effect, dB, whole picture / dynamic region, colours aligned."""
    rows = [[name, *(_loss(result, variant) for result in results)] for name, variant in effects.WITHOUT.items()]
    return [
        "## What a scene loses without an effect",
        "",
        "PSNR of the held-out view once its colours are brought to the recording's, dB against auto: whole picture / "
        "dynamic region. “not detected”: the same run as auto.",
        "",
        *markdown(["without", *(result.bench.name for result in results)], rows),
        "",
    ]


def _loss(result: RigResults, variant: Variant) -> str:
    bench, runs, auto = result.bench, result.runs_of(variant), result.runs_of(effects.AUTO)
    if not runs or not auto:
        return NOTHING
    if bench.key(variant) == bench.key(effects.AUTO):
        return "not detected"
    measures = (Measure("psnr_aligned", "aligned"), MOVING)
    return " / ".join(measure.write(estimate(measure.paired(runs, auto).values())) for measure in measures)
