"""Rows as points between what one pays and what one gets, and the Pareto front of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ..estimates import Estimate
from ..questions.variants import Question
from ..runs.results import RigResults
from ..tables.columns import COLUMNS


@dataclass(frozen=True)
class Axis:
    """A figure that can be plotted: its key in ``tables.columns.COLUMNS``, its label, and how many of its units one of
    the column's is."""

    key: str
    label: str
    more_is_better: bool = False
    units: float = 1.0


COSTS = (
    Axis("cpu", "processor seconds per frame"),
    Axis("megabytes", "kB per later frame", units=1e3),
    Axis("decode_fps", "decode FPS of one core", more_is_better=True),
)
QUALITY = Axis("psnr_dynamic", "PSNR where things move, dB", more_is_better=True)


@dataclass(frozen=True)
class Point:
    """A row of a family: its figures by axis, in the axis' units, means over seeds with their errors."""

    family: str
    label: str
    figures: dict[str, Estimate | None]

    def at(self, axis: Axis) -> float | None:
        """Where it lies on the axis."""
        figure = self.figures[axis.key]
        return None if figure is None else figure.mean

    def error(self, axis: Axis) -> float | None:
        """The standard error of that; None with one seed."""
        figure = self.figures[axis.key]
        return None if figure is None else figure.error


def points_of(questions: Sequence[Question], result: RigResults) -> list[Point]:
    """All rows of which there is a run; a run that answers two questions is a point of both."""
    points = []
    for question in questions:
        for variant in question.variants:
            runs = list(result.runs_of(variant).values())
            if runs:
                figures = {
                    axis.key: _in_units(COLUMNS[axis.key].over(runs, runs), axis.units) for axis in (*COSTS, QUALITY)
                }
                points.append(Point(question.key, variant.description, figures))
    return points


def _in_units(figure: Estimate | None, units: float) -> Estimate | None:
    if figure is None:
        return None
    return Estimate(units * figure.mean, None if figure.error is None else units * figure.error)


def find_front(points: Sequence[Point], cost: Axis) -> list[Point]:
    """The points that no other one beats in both cost and quality, from the cheapest to the dearest; by their means."""
    priced = []
    for index, point in enumerate(points):
        price, value = point.at(cost), point.at(QUALITY)
        if price is not None and value is not None:
            priced.append((-price if cost.more_is_better else price, -value, index))
    best, front = -math.inf, []
    for _, lost, index in sorted(priced):
        if -lost > best:
            front.append(points[index])
            best = -lost
    return front


def shown_range(points: Sequence[Point]) -> tuple[float, float]:
    """What a plot needs to show of the quality: the first family and all that is better, with some room around.

    What is far below would press the rest together. 0 to 1 when nothing has that quality.
    """
    measured = [(value, point) for point in points if (value := point.at(QUALITY)) is not None]
    if not measured:
        return 0.0, 1.0
    worst = min(value for value, point in measured if point.family == measured[0][1].family)
    best = max(value for value, _ in measured)
    span = max(best - worst, 1e-6)
    return worst - 0.2 * span, best + 0.1 * span
