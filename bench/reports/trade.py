"""Runs as points between cost and quality: the axes there are, and the Pareto front of every pair of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..estimates import Estimate, estimate
from ..runs.results import Plan, RigResults
from ..runs.rig_bench import KEYFRAME, Run
from ..tables.columns import cpu_seconds, decode_fps, later, mean, mean_of, wall_seconds


@dataclass(frozen=True)
class Axis:
    """A figure of a run that can be plotted: what it says, whether more of it is better, and how many digits it has.

    ``unit``: of a quality; of a cost what one more of it is. ``figure`` takes a run and the one that trained its
    keyframe, None when that is not there.
    """

    key: str
    label: str
    unit: str
    more_is_better: bool
    digits: int
    figure: Callable[[Run, Run | None], float | None]


@dataclass(frozen=True)
class Point:
    """A row of a family: its figures by axis, means over seeds, and the runs and the first one's command.

    ``errors``: the figures' standard errors, where there are several seeds.
    """

    family: str
    label: str
    variant: str
    runs: list[str]
    command: str
    figures: dict[str, float | None]
    errors: dict[str, float | None] = field(default_factory=dict)

    def estimate(self, axis: Axis) -> Estimate | None:
        """The figure with its error."""
        mean = self.figures[axis.key]
        return None if mean is None else Estimate(mean, self.errors.get(axis.key))


@dataclass(frozen=True)
class Step:
    """A point of a front, by its place among the points.

    ``gain``: quality won since the step before, per unit of cost; None at the first.
    """

    point: int
    gain: float | None


def gain_heading(cost: Axis, quality: Axis) -> str:
    """What a step's gain is counted in."""
    return f"{quality.unit} gained per {cost.unit}"


def _average(key: str, label: str, unit: str, digits: int) -> Axis:
    return Axis(key, label, unit, True, digits, lambda run, _: mean_of(run, key))


COSTS = (
    Axis("cpu", "processor seconds per frame", "extra processor second", False, 2, lambda run, _: cpu_seconds(run)),
    Axis("seconds", "seconds per frame, wall clock", "extra second", False, 2, lambda run, _: wall_seconds(run)),
    Axis(
        "kilobytes", "kB per later frame", "extra kB", False, 2, lambda run, _: mean(f.bytes / 1e3 for f in later(run))
    ),
    Axis(
        "kilobytes_all",
        "kB per frame, keyframe included",
        "extra kB",
        False,
        1,
        lambda run, _: run.stream_bytes / len(run.frames) / 1e3,
    ),
    Axis(
        "decode_fps",
        "decode FPS of one core",
        "frame a second less",
        True,
        1,
        lambda run, _: decode_fps(run),
    ),
    Axis(
        "keyframe_cpu",
        "processor seconds of the keyframe",
        "extra processor second",
        False,
        1,
        lambda _, source: None if source is None else source.frames[0].cpu_seconds,
    ),
)
"""What one pays, the first pair's first."""

QUALITIES = (
    _average("psnr_dynamic", "PSNR where things move, dB", "dB", 2),
    _average("psnr", "PSNR, whole picture, dB", "dB", 2),
    _average("psnr_static", "PSNR where nothing moves, dB", "dB", 2),
    _average("ssim_dynamic", "SSIM where things move", "SSIM", 4),
    _average("ssim", "SSIM, whole picture", "SSIM", 4),
    _average("ssim_static", "SSIM where nothing moves", "SSIM", 4),
)
"""What one gets, of the held-out camera; means over all frames."""


def points_of(plan: Plan, result: RigResults) -> list[Point]:
    """All rows of which there is a run; a run that answers two questions is a point of both."""
    points = []
    for question in plan.questions:
        for variant in question.variants:
            runs = result.runs_of(variant)
            if runs:
                first, keys = next(iter(runs.values())), [run.key for run in runs.values()]
                figures, errors = _figures(runs, runs if variant.own_keyframe else result.runs_of(KEYFRAME))
                row = (question.key, variant.description, variant.name)
                points.append(Point(*row, keys, first.command, figures, errors))
    return points


def _figures(
    runs: Mapping[int, Run], sources: Mapping[int, Run]
) -> tuple[dict[str, float | None], dict[str, float | None]]:
    """Means over seeds by axis, and their standard errors; ``sources``: what trained the keyframes."""
    found = {
        axis.key: estimate(axis.figure(run, sources.get(seed)) for seed, run in runs.items())
        for axis in (*COSTS, *QUALITIES)
    }
    means = {key: None if figure is None else figure.mean for key, figure in found.items()}
    return means, {key: None if figure is None else figure.error for key, figure in found.items()}


def front(points: Sequence[Point], cost: Axis, quality: Axis) -> list[Step]:
    """The points that no other one beats in both, from the cheapest to the dearest; by their means."""
    known = []
    for place, point in enumerate(points):
        price, value = point.figures[cost.key], point.figures[quality.key]
        if price is not None and value is not None:
            known.append((-price if cost.more_is_better else price, -value, place))
    steps: list[Step] = []
    best, paid = -math.inf, 0.0
    for price, lost, place in sorted(known):
        if -lost > best:
            steps.append(Step(place, (-lost - best) / (price - paid) if steps else None))
            best, paid = -lost, price
    return steps


def shown_range(points: Sequence[Point], quality: Axis) -> tuple[float, float]:
    """What a plot needs to show of a quality: the first family and all that is better, with some room around.

    What is far below would press the rest together. 0 to 1 when nothing has that quality.
    """
    known = [(value, point) for point in points if (value := point.figures[quality.key]) is not None]
    if not known:
        return 0.0, 1.0
    worst = min(value for value, point in known if point.family == known[0][1].family)
    best = max(value for value, _ in known)
    span = max(best - worst, 1e-6)
    return worst - 0.2 * span, best + 0.1 * span


def trade_document(plan: Plan, result: RigResults) -> dict[str, Any]:
    """A rig's points, its fronts by "cost quality", and how the loss fell inside frames, as plain data."""
    points = points_of(plan, result)
    fronts = {f"{cost.key} {quality.key}": front(points, cost, quality) for cost in COSTS for quality in QUALITIES}
    return {
        "points": [vars(point) for point in points],
        "fronts": {pair: [vars(step) for step in steps] for pair, steps in fronts.items()},
        "ranges": {quality.key: shown_range(points, quality) for quality in QUALITIES},
        "courses": {label: vars(course) for label, course in result.courses.items()},
        "precision": None if result.precision is None else vars(result.precision),
    }


def axes_document() -> dict[str, Any]:
    """The axes as plain data, in their order."""

    def plain(axis: Axis) -> dict[str, Any]:
        return {
            "key": axis.key,
            "label": axis.label,
            "unit": axis.unit,
            "more": axis.more_is_better,
            "digits": axis.digits,
        }

    return {"costs": [plain(axis) for axis in COSTS], "qualities": [plain(axis) for axis in QUALITIES]}
