"""The optimiser's step sizes."""

from __future__ import annotations

from dataclasses import dataclass, fields

from .checked import Checked, Rate


@dataclass(frozen=True)
class LearningRates(Checked):
    """Adam's step sizes, each in the unit of its stored value. Larger is faster, and settles later."""

    means: Rate  # world units
    log_scales: Rate  # logarithms
    quaternions: Rate  # of a quaternion of length one
    opacity_logits: Rate  # logits
    sh_dc: Rate  # spherical harmonics of degree 0
    sh_rest: Rate  # of higher degrees

    def scaled(self, factor: float) -> LearningRates:
        """All of them times ``factor``."""
        return LearningRates(*(getattr(self, f.name) * factor for f in fields(self)))
