"""Pictures brighter than white: scene-linear values beyond 1 in more than a trace of the pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .effect import Decision, Evidence, cameras_beyond, decided, spans
from .look import Look

if TYPE_CHECKING:
    from ..settings.encode import EncodeSettings

_TRACE = 0.01
"""Per cent of a picture's pixels: ten at 352 x 264, fewer are a glint."""


class HighDynamicRange:
    """Pictures brighter than white."""

    name = "high_dynamic_range"

    def evidence(self, look: Look) -> Evidence:
        shares = np.where(np.isfinite(look.above_white), look.above_white, 0.0)
        return Evidence(shares * 100, "% of pixels", _TRACE, {"brightest": look.brightest})

    def decide(self, look: Look, evidence: Evidence) -> Decision:
        beyond = cameras_beyond(evidence)
        brightest = float(np.nan_to_num(look.brightest, nan=1.0).max())
        known = np.isfinite(look.brightest).any()
        return decided(
            look,
            self,
            evidence,
            counts=beyond,
            frames=spans(look, np.any(evidence.reached, axis=0)),
            reason=f"{evidence.peak:.3g} % of a picture lies beyond white, up to {brightest:.4g} times it"
            if known
            else "8-bit pictures end at white",
            cost="clipped at white as long as the format keeps display-referred colours: nothing",
            figures={"brightest": brightest},
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        """Told of only: a stream keeps display-referred colours, and what is brighter than white is clipped."""
        return settings

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return settings
