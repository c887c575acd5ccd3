"""The optimiser's step sizes."""

from __future__ import annotations

from dataclasses import dataclass, fields

from .checked import Checked, Rate


@dataclass(frozen=True)
class LearningRates(Checked):
    """Adam's step sizes, in the unit of each stored value (``means``: world units). Larger is faster, settles later."""

    means: Rate
    log_scales: Rate
    quaternions: Rate
    opacity_logits: Rate
    sh_dc: Rate
    sh_rest: Rate

    def scaled(self, factor: float) -> LearningRates:
        """All of them times ``factor``."""
        return LearningRates(*(getattr(self, f.name) * factor for f in fields(self)))
