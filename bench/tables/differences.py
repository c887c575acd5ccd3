"""What a row has more or less than the row it is compared with, seed by seed: by this, choices are kept or deleted.

Chosen: differences within a seed, whose rows begin with one keyframe, and then their mean and standard error. Seeds
differ by .1 to .4 dB; what all rows of a seed have in common drops out. Rejected: the difference of two means with the
errors of both (it keeps that part), and one seed (a row that is lucky with it makes all the others look worse).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..estimates import NOTHING, Estimate, estimate, rounded, written
from ..questions.variants import Question, Variant
from ..runs.results import RigResults
from ..runs.run import Run
from .columns import COLUMNS, markdown


@dataclass(frozen=True)
class Measure:
    """A figure that rows are compared by: its key in ``tables.COLUMNS``, a word for it, and which way is better.

    ``relative``: in per cent of the other row's; in dB otherwise.
    """

    key: str
    word: str
    more_is_better: bool = True
    relative: bool = False

    @property
    def heading(self) -> str:
        """The word with its unit."""
        return f"{self.word}, {'%' if self.relative else 'dB'}"

    @property
    def form(self) -> str:
        """How a difference is written."""
        return "+.1f" if self.relative else "+.2f"

    def write(self, difference: Estimate | None) -> str:
        """A difference as text."""
        return written(difference, self.form)

    def is_clear(self, difference: Estimate | None) -> bool:
        """Whether it is more than two standard errors, and not nothing in the digits that are written."""
        return difference is not None and difference.is_clear and float(format(difference.mean, self.form)) != 0

    def difference(self, run: Run, other: Run) -> float | None:
        """What ``run`` has more; None where one of them has no such figure or they are of other frames."""
        if [frame.frame for frame in run.frames] != [frame.frame for frame in other.frames]:
            return None
        ours, theirs = (COLUMNS[self.key].over([one], [one]) for one in (run, other))
        if ours is None or theirs is None or (self.relative and theirs.mean == 0):
            return None
        return 100 * (ours.mean / theirs.mean - 1) if self.relative else ours.mean - theirs.mean

    def paired(self, runs: Mapping[int, Run], others: Mapping[int, Run]) -> dict[int, float]:
        """The differences by seed, of the seeds that both have."""
        by_seed = {seed: self.difference(run, others[seed]) for seed, run in runs.items() if seed in others}
        return {seed: value for seed, value in by_seed.items() if value is not None}


MOVING = Measure("psnr_dynamic", "dynamic")
BYTES = Measure("megabytes", "bytes", more_is_better=False, relative=True)
CPU = Measure("cpu", "CPU-s", more_is_better=False, relative=True)
MEASURES = (
    Measure("psnr", "PSNR"),
    MOVING,
    Measure("psnr_static", "static"),
    Measure("last_dynamic", "last frame"),
    BYTES,
    CPU,
)


@dataclass(frozen=True)
class Differences:
    """A row against the one it is compared with: differences by the measure's key and by seed."""

    variant: Variant
    by_seed: Mapping[str, Mapping[int, float]]

    def of(self, measure: Measure) -> Estimate | None:
        """Mean and standard error over the seeds."""
        return estimate(self.by_seed[measure.key].values())

    def verdict(self) -> str:
        """What the row gains and what it costs, as far as that is larger than two standard errors."""
        words: dict[str, list[str]] = {"gains": [], "costs": []}
        for measure in MEASURES:
            difference = self.of(measure)
            if difference is not None and measure.is_clear(difference):
                is_gain = (difference.mean > 0) == measure.more_is_better
                words["gains" if is_gain else "costs"].append(measure.word)
        return "; ".join(f"{what} {', '.join(those)}" for what, those in words.items() if those) or NOTHING

    def document(self) -> dict[str, Any]:
        """The same numbers for JSON, dB and per cent."""
        means = {measure.key: self.of(measure) for measure in MEASURES}
        return {
            key: rounded({"mean": mean.mean, "error": mean.error, "seeds": dict(self.by_seed[key])})
            for key, mean in means.items()
            if mean is not None
        }


def differences(result: RigResults, question: Question) -> Iterator[Differences]:
    """The question's rows against its reference, without those that are the same run or have nothing to compare."""
    reference = result.reference(question)
    if reference is None:
        return
    others = result.runs_of(reference)
    for variant in question.variants:
        if result.bench.key(variant) != result.bench.key(reference):
            runs = result.runs_of(variant)
            row = Differences(variant, {measure.key: measure.paired(runs, others) for measure in MEASURES})
            if any(row.by_seed.values()):
                yield row


def difference_table(result: RigResults, question: Question) -> list[str]:
    """The lines of a question's table of differences; none where nothing can be compared."""
    rows = [
        [row.variant.description, *(measure.write(row.of(measure)) for measure in MEASURES), row.verdict()]
        for row in differences(result, question)
    ]
    reference = result.reference(question)
    if reference is None or not rows:
        return []
    headings = ["", *(measure.heading for measure in MEASURES), "beyond two standard errors"]
    return [f"Differences to “{reference.description}”, paired by seed:", "", *markdown(headings, rows), ""]
