"""What is there of a rig: its runs by variant and seed, its rivals, and what failed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..questions.variants import Question, Variant
from .rig_bench import RigBench
from .rivals import RivalRun
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

    def reference(self, question: Question) -> Variant | None:
        """The row that the question's other rows are compared with; None when there is none."""
        presets = (variant for variant in question.variants if self.is_preset(variant))
        return question.reference or next(presets, None)

    def is_preset(self, variant: Variant) -> bool:
        """Whether the variant has the same settings as the preset, or as the keyframe's run."""
        return self.bench.key(variant) in (self.bench.key(Variant("", "")), self.bench.key(KEYFRAME))
