"""What is there of a rig: its runs by variant and seed, its rivals, and what failed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..questions.variants import Question, Variant
from .rig_bench import RigBench
from .rivals import RatePoint, RivalRun, point_of, point_of_rival
from .run import KEYFRAME, Run


@dataclass
class RigResults:
    """A rig's runs by key, what went wrong by the variant's or rival's name, and rivals by theirs.

    Rivals are of the first seed.
    """

    bench: RigBench
    runs: dict[str, Run] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    rivals: dict[str, RivalRun] = field(default_factory=dict)

    def runs_of(self, variant: Variant) -> dict[int, Run]:
        """The variant's runs by seed, those that were made."""
        keys = {seed: self.bench.key(replace(variant, seed=seed)) for seed in self.bench.options.seeds}
        return {seed: self.runs[key] for seed, key in keys.items() if key in self.runs}

    def run_of(self, variant: Variant) -> Run | None:
        """The variant's run with the first seed, for what shows one run; None when it was not made."""
        return self.runs.get(self.bench.key(variant))

    def rate_points(self, labels: Mapping[str, Variant]) -> list[RatePoint]:
        """The streams of ``labels`` and all rivals as points, those that are there."""
        runs = {label: self.run_of(variant) for label, variant in labels.items()}
        ours = [point_of(run, label) for label, run in runs.items() if run is not None]
        return ours + [point_of_rival(run) for run in self.rivals.values()]

    def reference(self, question: Question) -> Variant | None:
        """The row that the question's other rows are compared with; None when there is none."""
        presets = (variant for variant in question.variants if self.is_preset(variant))
        return question.reference or next(presets, None)

    def is_preset(self, variant: Variant) -> bool:
        """Whether the variant has the same settings as the preset, or as the keyframe's run."""
        return self.bench.key(variant) in (self.bench.key(Variant("", "")), self.bench.key(KEYFRAME))
