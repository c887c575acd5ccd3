"""What a report says first, over all rigs: DecoGS against its baseline."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from . import paper
from .plans import RigResults
from .runs import Run
from .tables import NOTHING, cpu_seconds, drift, flicker, markdown, mean_of, wall_seconds, with_error


def against_baseline(results: Sequence[RigResults]) -> list[str]:
    """DecoGS against the baseline, rig by rig: what the paper claims, as ratios."""
    rows = []
    for result in results:
        baseline = result.run_of(paper.BASELINE)
        for variant in (paper.DECOGS_AUTO, paper.DECOGS, paper.DECOGS_PAPER):
            run = result.run_of(variant)
            if run is not None and baseline is not None:
                rows.append([result.bench.name, variant.description, *_comparison(run, baseline)])
    if not rows:
        return []
    headings = [
        "rig", "method", "dynamic PSNR over the baseline's, dB", "mTV ×100 / baseline's",
        "s/frame / baseline's", "CPU-s/frame / baseline's", "slope, dB per 100 frames", "slope dynamic",
    ]  # fmt: skip
    return ["## DecoGS against the baseline", "", *markdown(headings, rows), ""]


def _comparison(run: Run, baseline: Run) -> list[str]:
    gain = _both(mean_of(run, "psnr_dynamic"), mean_of(baseline, "psnr_dynamic"), lambda a, b: f"{a - b:+.2f}")
    still = _both(flicker(run), flicker(baseline), lambda a, b: f"{a:.4f} / {b:.4f}{_ratio(a, b)}")
    wall = _both(wall_seconds(run), wall_seconds(baseline), lambda a, b: f"{a:.2f} / {b:.2f}{_ratio(a, b)}")
    cpu = _both(cpu_seconds(run), cpu_seconds(baseline), lambda a, b: f"{a:.2f} / {b:.2f}{_ratio(a, b)}")
    return [gain, still, wall, cpu, with_error(drift(run, "psnr")), with_error(drift(run, "psnr_dynamic"))]


def _both(a: float | None, b: float | None, write: Callable[[float, float], str]) -> str:
    return NOTHING if a is None or b is None else write(a, b)


def _ratio(a: float, b: float) -> str:
    return f" = 1/{b / a:.1f}" if a > 0 and b > 0 else ""
