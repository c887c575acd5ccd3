"""Light or colour changes while the geometry stays: lamps, screens, shadows of objects outside the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import Decision, Effect, Evidence
from .motion import decide_by_change
from .rig_statistics import F64, RigStatistics

LIMIT = 0.2
"""Share of a change away from motion: the geometric mean of its values for shadows of moving objects and for light."""

_MIN_FRACTION = 0.001
"""Share of a picture below which a change is a speck: 93 pixels of 352 x 264."""


class AppearanceChange(Effect):
    """Evidence: share of the changed pixels away from motion; near it, shadows belong to the motion. Changes too slow
    to detect between successive frames are detected over several."""

    name = "appearance_change"

    def evidence(self, stats: RigStatistics) -> Evidence:
        changed, alone, share = _away_from_motion(stats, "changed", "near")
        _, _, slow = _away_from_motion(stats, "slow_changed", "slow_near")
        details = {"changed": changed * 100, "alone": alone * 100, "slow": slow * 100}
        return Evidence(np.fmax(share, slow) * 100, "% away from motion", LIMIT * 100, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        area = float(np.nan_to_num(evidence.details["alone"]).max())
        return decide_by_change(
            stats,
            self,
            evidence,
            reason=f"up to {area:.2g} % of a picture changes between two frames, in place and away from motion",
            cost="training and coding of colours and opacities: 13 kB and 1.5 CPU-s a frame (measured on candle)",
            figures={"alone_percent": area},
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """Colours and opacities stay as they are."""
        rates = replace(settings.frame.rates, opacity_logits=0.0, sh_dc=0.0, sh_rest=0.0)
        return replace(settings, frame=replace(settings.frame, rates=rates))


def _away_from_motion(stats: RigStatistics, *names: str) -> tuple[F64, F64, F64]:
    """Arrays (cameras, F): share of changed pixels, share of those away from motion, ratio of second to first."""
    changed, near = (np.stack([getattr(shares, name) for shares in stats.changes]) for name in names)
    alone = changed - near
    share = alone / np.maximum(changed, 1e-9)
    share[alone < _MIN_FRACTION] = 0
    return changed, alone, share
