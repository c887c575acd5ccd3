"""Disappearance: an object leaves the pictures, or goes behind or into another object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import Decision, Effect, Evidence
from .emergence import IMBALANCE, decide_by_vote, none_without_motion
from .rig_statistics import RigStatistics


class Disappearance(Effect):
    """Something that is gone in the end."""

    name = "disappearance"

    def evidence(self, stats: RigStatistics) -> Evidence:
        values = np.stack([arrivals.left for arrivals in stats.arrivals])
        return Evidence(none_without_motion(stats, values), "% imbalance", IMBALANCE)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        return decide_by_vote(
            stats,
            self,
            evidence,
            what="an object vanishes without arriving at another place",
            cost="pruning: no training, 1 bit per Gaussian before entropy coding (estimated)",
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """Transparent Gaussians stay."""
        return replace(settings, frame=replace(settings.frame, prune_opacity=0.0))
