"""Something is there in the end that was not there before, and did not come from elsewhere in the pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .effect import F64, Decision, Effect, Evidence, confidence, decided, seen_together, spans
from .motion import Motion
from .rig_statistics import RigStatistics

if TYPE_CHECKING:
    from ..settings.encode import EncodeSettings

IMBALANCE = 60.0
"""Per cent by which arrivals and departures must differ: what moves towards a camera grows, and arrives larger than it
left; by 60 % it would be four times as large."""
_MOTION = Motion()
_LEAST_SHARE = 0.25
"""Share of the cameras that must see it: what merely enters or leaves the picture of one is motion to the others."""


class Emergence:
    name = "emergence"

    def evidence(self, stats: RigStatistics) -> Evidence:
        values = np.stack([arrivals.arrived for arrivals in stats.arrivals])
        return Evidence(none_without_motion(stats, values), "% arrived only", IMBALANCE)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        return decide_by_vote(
            stats,
            self,
            evidence,
            what="show at their end what was not there at their start and came from nowhere in the picture",
            cost="seeding and densification in these frames: a few tenths of a CPU-s and kB a frame (estimated)",
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return settings

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """No seeds are sought, and no Gaussian is split."""
        frame = settings.frame
        frame = replace(frame, grow_fraction=0.0, emergence=replace(frame.emergence, max_seeds=0))
        return replace(settings, frame=frame)


def none_without_motion(stats: RigStatistics, values: F64) -> F64:
    """The values (cameras, F) with 0 in cameras in which nothing moves: what came or went there is light."""
    moving = _MOTION.evidence(stats)
    still = np.isfinite(moving.values) & ~moving.reached.any(axis=1, keepdims=True)
    return np.asarray(np.where(still, 0.0, values))


def decide_by_vote(stats: RigStatistics, effect: Effect, evidence: Evidence, *, what: str, cost: str) -> Decision:
    """Called for where a quarter of the cameras, at least two, agree; only as sure as there are cameras that tell."""
    needed = max(2, math.ceil(_LEAST_SHARE * len(stats.cameras)))
    frames = seen_together(evidence, needed)
    votes = int(np.any(evidence.reached, axis=1).sum())
    known = int(np.isfinite(evidence.values).any(axis=1).sum())
    figures: dict[str, Any] = {"cameras_that_tell": known, "cameras_that_see_it": votes}
    detected = bool(frames.any())
    sure = (votes if detected else known - votes) / len(stats.cameras)
    return decided(
        stats,
        effect,
        evidence,
        counts=np.asarray((evidence.reached & frames).any(axis=1)),
        frames=spans(stats, frames),
        reason=f"{votes} of {len(stats.cameras)} cameras {what}; {known} could tell",
        cost=cost,
        sure=max(confidence(evidence), 0.5) * sure if known else 0.0,
        figures=figures,
    )
