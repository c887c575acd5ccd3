"""What a report asks: its questions, figures and contest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from ..questions.variants import Question, Variant
from ..rivals.sequences import Rival
from ..runs.results import RigResults
from ..runs.rivals import DECOGS
from ..runs.run import KEYFRAME


@dataclass(frozen=True)
class Contest:
    """The encoder's rates, finest first, and rivals that keep the frames of the finest; ``key`` for ``--only``.

    ``anchor``: the family that BD-rates are against.
    """

    key: str
    rates: tuple[Variant, ...]
    rivals: tuple[Rival, ...]
    anchor: str = DECOGS

    @property
    def source(self) -> Variant:
        """The encode whose frames the rivals keep."""
        return self.rates[0]


@dataclass(frozen=True)
class Plan:
    """A kind of report: its name (of the files, too), heading, questions, and figures with the variants they show.

    ``front``: whether the rows are points between cost and quality, drawn with their Pareto front. ``summary``: lines
    that stand before the rigs' sections.
    """

    name: str
    title: str
    questions: tuple[Question, ...]
    figures: Mapping[str, tuple[Variant, ...]] = field(default_factory=dict)
    contest: Contest | None = None
    front: bool = False
    summary: Callable[[Sequence[RigResults]], list[str]] | None = None

    @property
    def lent(self) -> tuple[Variant, ...]:
        """Variants whose streams are needed after their own run."""
        return (KEYFRAME,) if self.contest is None else (KEYFRAME, self.contest.source)
