"""Emergence: a new object that does not come from elsewhere in the pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import F64, Decision, Effect, Evidence, confidence, decided, seen_together, spans, stated
from .motion import Motion
from .rig_statistics import RigStatistics

IMBALANCE = 60.0
"""Least imbalance of arrivals and departures, in per cent: an object that moves towards a camera grows and arrives
larger than it left; 60 % is four times as large."""
_MOTION = Motion()
_MIN_FRACTION = 0.25
"""Least share of cameras with the evidence: an object that enters one picture merely moves in the others."""


class Emergence(Effect):
    """Something that is there in the end and was not before."""

    name = "emergence"

    def evidence(self, stats: RigStatistics) -> Evidence:
        values = np.stack([arrivals.arrived for arrivals in stats.arrivals])
        return Evidence(none_without_motion(stats, values), "% imbalance", IMBALANCE)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        return decide_by_vote(
            stats,
            self,
            evidence,
            what="an object appears without leaving another place",
            cost="seeding and densification: a few tenths of a CPU-s and of a kB a frame (estimated)",
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """Neither the search for emerging objects nor densification."""
        frame = settings.frame
        frame = replace(frame, grow_fraction=0.0, emergence=replace(frame.emergence, max_seeds=0))
        return replace(settings, frame=frame)


def none_without_motion(stats: RigStatistics, values: F64) -> F64:
    """The values (cameras, F), 0 in cameras without motion, where arrivals and departures are light."""
    moving = _MOTION.evidence(stats)
    still = np.isfinite(moving.values) & ~moving.reached.any(axis=1, keepdims=True)
    return np.asarray(np.where(still, 0.0, values))


def decide_by_vote(stats: RigStatistics, effect: Effect, evidence: Evidence, *, what: str, cost: str) -> Decision:
    """Detected if a quarter of the cameras agree, at least two; confidence falls with undetermined cameras."""
    needed = max(2, math.ceil(_MIN_FRACTION * len(stats.cameras)))
    frames = seen_together(evidence, needed)
    votes = int(np.any(evidence.reached, axis=1).sum())
    known = int(np.isfinite(evidence.values).any(axis=1).sum())
    figures: dict[str, Any] = {"cameras_determined": known, "cameras_that_see_it": votes}
    detected = bool(frames.any())
    sure = (votes if detected else known - votes) / len(stats.cameras)
    return decided(
        stats,
        effect,
        evidence,
        counts=np.asarray((evidence.reached & frames).any(axis=1)),
        frames=spans(stats, frames),
        reason=stated(evidence, f"{what} in {votes} of {known} conclusive cameras", "no camera is conclusive"),
        cost=cost,
        sure=max(confidence(evidence), 0.5) * sure if known else 0.0,
        figures=figures,
    )
