"""What a report asks: its questions, figures and contest, and what runs answered them, rig by rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from ..questions.variants import Question, Variant
from ..rivals.sequences import Rival
from .courses import Course
from .precision import Precision
from .rig_bench import KEYFRAME, RigBench, Run
from .rivals import RivalRun


@dataclass(frozen=True)
class Contest:
    """The encoder's rates, finest first, and rivals that keep the frames of the finest; ``key`` for ``--only``."""

    key: str
    rates: tuple[Variant, ...]
    rivals: tuple[Rival, ...]

    @property
    def source(self) -> Variant:
        """The encode whose frames the rivals keep."""
        return self.rates[0]


@dataclass(frozen=True)
class Trade:
    """That the rows are points between cost and quality: fronts, plots and a page to explore them.

    ``followed``: variants of which the loss inside frames is kept. ``source``: whose last frame the kernel and its
    float64 twin are compared on; ``key`` for ``--only``.
    """

    key: str
    source: Variant
    followed: tuple[Variant, ...]


@dataclass(frozen=True)
class Plan:
    """A kind of report: its name (of the files, too), heading, questions, and figures with the variants they show.

    ``summary``: lines that stand before the rigs' sections.
    """

    name: str
    title: str
    questions: tuple[Question, ...]
    figures: Mapping[str, tuple[Variant, ...]] = field(default_factory=dict)
    contest: Contest | None = None
    trade: Trade | None = None
    summary: Callable[[Sequence[RigResults]], list[str]] | None = None

    @property
    def lent(self) -> tuple[Variant, ...]:
        """Variants whose streams are needed after their own run."""
        sources = [part.source for part in (self.contest, self.trade) if part is not None]
        return (KEYFRAME, *sources)

    @property
    def followed(self) -> tuple[Variant, ...]:
        """Variants of which the loss inside frames is kept."""
        return () if self.trade is None else self.trade.followed


@dataclass
class RigResults:
    """A rig's runs by key, what went wrong by the variant's or rival's name, and rivals by theirs.

    ``courses``: how the loss fell inside frames, by the variant's description. ``precision``: of the kernel. These and
    rivals are of the first seed.
    """

    bench: RigBench
    runs: dict[str, Run] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    rivals: dict[str, RivalRun] = field(default_factory=dict)
    courses: dict[str, Course] = field(default_factory=dict)
    precision: Precision | None = None

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
