"""What a report says first, over all rigs: DecoGS against its baseline."""

from __future__ import annotations

from collections.abc import Sequence

from ..estimates import NOTHING, estimate
from ..questions import paper
from ..questions.variants import Variant
from ..runs.results import RigResults
from ..tables.columns import COLUMNS, markdown
from ..tables.differences import MOVING


def against_baseline(results: Sequence[RigResults]) -> list[str]:
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
        "rig", "method", "dynamic PSNR over the baseline's, dB", "mTV ×100 / baseline's",
        "s/frame / baseline's", "CPU-s/frame / baseline's", "slope, dB per 100 frames", "slope dynamic",
    ]  # fmt: skip
    return ["## DecoGS against the baseline", "", *markdown(headings, rows), ""]


def _comparison(result: RigResults, variant: Variant) -> list[str]:
    runs, baseline = result.runs_of(variant), result.runs_of(paper.BASELINE)
    gain = MOVING.write(estimate(MOVING.paired(runs, baseline).values()))
    ours, theirs = list(runs.values()), list(baseline.values())
    ratios = []
    for key in ("mtv", "seconds", "cpu"):
        column = COLUMNS[key]
        a, b = column.over(ours, ours), column.over(theirs, theirs)
        ratios.append(NOTHING if a is None or b is None else _ratio(a.mean, b.mean, column.form))
    return [gain, *ratios, *(COLUMNS[key].value(ours, ours) for key in ("slope", "slope_dynamic"))]


def _ratio(a: float, b: float, form: str) -> str:
    return f"{a:{form}} / {b:{form}}" + (f" = 1/{b / a:.1f}" if a > 0 and b > 0 else "")
