"""Figures of a report: rounded in its files, and over several seeds with the standard error of their mean.

Chosen: two standard errors as the mark of a difference, because anyone can check it against the figure beside it. It is
a weak mark with few seeds: where two rows do not differ, 18 % of the differences over three seeds lie beyond it by
chance, 30 % over two (Student's t with n - 1 degrees of freedom). A choice therefore needs two rigs that agree.
Rejected: the quantiles of Student's t (4.3 errors for three seeds: nothing but gross differences would be marked).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

NOTHING = "–"


@dataclass(frozen=True)
class Estimate:
    """A figure and its standard error; None where there is but one value."""

    mean: float
    error: float | None = None

    @property
    def is_clear(self) -> bool:
        """Whether it lies more than two standard errors from zero."""
        return self.error is not None and abs(self.mean) > 2 * self.error


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of the values there are; None when there are none."""
    present = [value for value in values if value is not None]
    return math.fsum(present) / len(present) if present else None


def estimate(values: Iterable[float | None]) -> Estimate | None:
    """Mean of the values there are, and its standard error: sample standard deviation over the root of their number."""
    present = [value for value in values if value is not None]
    if not present:
        return None
    error = statistics.stdev(present) / math.sqrt(len(present)) if len(present) > 1 else None
    return Estimate(math.fsum(present) / len(present), error)


def written(figure: Estimate | None, form: str, nothing: str = NOTHING) -> str:
    """A figure as the format specification ``form`` says, and its error with the same digits."""
    if figure is None:
        return nothing
    error = "" if figure.error is None else f" ± {figure.error:{form.lstrip('+')}}"
    return f"{figure.mean:{form}}{error}"


def about_seeds(seeds: Sequence[int]) -> str:
    """What a report's figures are of, and what their errors are."""
    if len(seeds) == 1:
        return (
            f"One run for each row, with seed {seeds[0]}. Other seeds differ by 0.1 to 0.4 dB: smaller differences "
            "mean little (--seeds)."
        )
    return (
        f"Figures are means over the seeds {', '.join(map(str, seeds))}, ± the standard error of that mean (sample "
        "standard deviation over the root of their number)."
    )


def rounded(value: Any) -> Any:
    """Floats to seven significant digits, in lists and mappings, too."""
    if isinstance(value, dict):
        return {name: rounded(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value
