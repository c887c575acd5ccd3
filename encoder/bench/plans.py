"""What a report asks: its questions, figures and contest, and what runs answered them, rig by rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from .rival_runs import RivalRun
from .rivals.sequences import Rival
from .runs import KEYFRAME, RigBench, Run
from .variants import Question, Variant


@dataclass(frozen=True)
class Contest:
    """The encoder's rates, finest first, and rivals that keep the frames of the finest; ``key`` for ``--only``."""

    key: str
    rates: tuple[Variant, ...]
    rivals: tuple[Rival, ...]

    @property
    def source(self) -> Variant:
        return self.rates[0]


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
    summary: Callable[[Sequence[RigResults]], list[str]] | None = None

    @property
    def lent(self) -> tuple[Variant, ...]:
        """Variants whose streams are needed after their own run."""
        return (KEYFRAME,) if self.contest is None else (KEYFRAME, self.contest.source)


@dataclass
class RigResults:
    """A rig's runs by key, what went wrong by the variant's or rival's name, and rivals by theirs."""

    bench: RigBench
    runs: dict[str, Run] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    rivals: dict[str, RivalRun] = field(default_factory=dict)

    def run_of(self, variant: Variant) -> Run | None:
        return self.runs.get(self.bench.key(variant))

    def is_preset(self, variant: Variant) -> bool:
        return self.bench.key(variant) in (self.bench.key(Variant("", "")), self.bench.key(KEYFRAME))
