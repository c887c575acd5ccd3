"""High dynamic range: scene-linear values above 1 in more than a trace of the pixels."""

from __future__ import annotations

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import Decision, Effect, Evidence, cameras_beyond, decided, spans
from .rig_statistics import RigStatistics

_TRACE = 0.01
"""Per cent of a picture's pixels: ten at 352 x 264, fewer are a glint."""


class HighDynamicRange(Effect):
    """Pictures brighter than white; reported only, since a stream is display-referred and clipped at white."""

    name = "high_dynamic_range"

    def evidence(self, stats: RigStatistics) -> Evidence:
        shares = np.where(np.isfinite(stats.above_white), stats.above_white, 0.0)
        return Evidence(shares * 100, "% of pixels", _TRACE, {"brightest": stats.brightest})

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        beyond = cameras_beyond(evidence)
        brightest = float(np.nan_to_num(stats.brightest, nan=1.0).max())
        known = np.isfinite(stats.brightest).any()
        return decided(
            stats,
            self,
            evidence,
            counts=beyond,
            frames=spans(stats, np.any(evidence.reached, axis=0)),
            reason=f"{evidence.peak:.3g} % of a picture exceeds white, by a factor of up to {brightest:.4g}"
            if known
            else "8-bit pictures cannot exceed white",
            cost="no bytes; colours are clipped at white, because a stream is display-referred",
            figures={"brightest": brightest},
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return settings
