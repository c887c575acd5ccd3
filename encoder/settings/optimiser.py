"""The optimiser's step sizes."""

from __future__ import annotations

from dataclasses import dataclass, fields


@dataclass(frozen=True)
class LearningRates:
    """Adam's step sizes, in the unit of each stored value (``means``: world units). Larger is faster, settles later."""

    means: float
    log_scales: float
    quaternions: float
    opacity_logits: float
    sh_dc: float
    sh_rest: float

    def scaled(self, factor: float) -> LearningRates:
        """All of them times ``factor``."""
        return LearningRates(*(getattr(self, f.name) * factor for f in fields(self)))
