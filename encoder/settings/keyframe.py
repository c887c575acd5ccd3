"""How the keyframe is trained, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from decogs.codec.scene.state import DEFAULT_MAX_GAUSSIANS

from .checked import Checked, Count, Loss, Share, Steps, Within

_SURROUNDINGS_SHARE = 0.025
"""Of the cap, for Gaussians beside the pictures."""


@dataclass(frozen=True)
class KeyframeSettings(Checked):
    """How the keyframe is trained. Beside each field: unit, and which way is slower."""

    iterations: Count = 1000  # steps, at most; large pictures take fewer; more: slower, better up to early stopping
    cap: Annotated[int, Within(1, DEFAULT_MAX_GAUSSIANS)] = 52_000  # Gaussians at most; more: slower, larger
    sh_degree: Annotated[int, Within(0, 3)] = 0  # more: slower, larger, better where views disagree
    few_views_dissimilarity: Share = 0.2  # weight of structure where few views see a surface; no slower
    grow_every: Count = 100  # steps between additions of Gaussians; fewer: slower
    validation_fraction: Annotated[float, Within(0, 0.9)] = 0.02  # of the pixels, for early stopping; 0: off, slower
    validation_every: Count = 100  # steps between checks for early stopping; fewer: slower
    settle_iterations: Steps = 300  # steps of fixing values on the lattice while others adapt; more: slower
    surroundings: Annotated[float, Within(0, 100)] = 0.0  # reach beside the pictures, in their widths; more: larger
    rd_lambda: Loss = 2.3e-3  # of the squared loss, in millionths, per bit; more: smaller, less exact; no slower

    @property
    def seen_cap(self) -> int:
        """Gaussians at most that views see; the rest of the cap is for those beside the pictures."""
        return self.cap - (round(_SURROUNDINGS_SHARE * self.cap) if self.surroundings else 0)
