"""Something is there in the end that was not there before, and did not come from elsewhere in the pictures."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from .effect import F64, Decision, Effect, Evidence, confidence, decided, seen_together, spans
from .look import Look
from .motion import Motion

if TYPE_CHECKING:
    from ..settings.encode import EncodeSettings

IMBALANCE = 60.0
"""Per cent by which arrivals and departures must differ: what moves towards a camera grows, and arrives larger than it
left; by 60 % it would be four times as large."""
_MOTION = Motion()
_LEAST_SHARE = 0.25
"""Share of the cameras that must see it: what merely enters or leaves the picture of one is motion to the others."""


class Emergence:
    """Something that is there in the end and was not before."""

    name = "emergence"

    def evidence(self, look: Look) -> Evidence:
        values = np.stack([arrivals.arrived for arrivals in look.arrivals])
        return Evidence(none_without_motion(look, values), "% arrived only", IMBALANCE)

    def decide(self, look: Look, evidence: Evidence) -> Decision:
        return decide_by_vote(
            look,
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


def none_without_motion(look: Look, values: F64) -> F64:
    """The values (cameras, F) with 0 in cameras in which nothing moves: what came or went there is light."""
    moving = _MOTION.evidence(look)
    still = np.isfinite(moving.values) & ~moving.reached.any(axis=1, keepdims=True)
    return np.asarray(np.where(still, 0.0, values))


def decide_by_vote(look: Look, effect: Effect, evidence: Evidence, *, what: str, cost: str) -> Decision:
    """Called for where a quarter of the cameras, at least two, agree; only as sure as there are cameras that tell."""
    needed = max(2, math.ceil(_LEAST_SHARE * len(look.cameras)))
    frames = seen_together(evidence, needed)
    votes = int(np.any(evidence.reached, axis=1).sum())
    known = int(np.isfinite(evidence.values).any(axis=1).sum())
    figures: dict[str, Any] = {"cameras_that_tell": known, "cameras_that_see_it": votes}
    detected = bool(frames.any())
    sure = (votes if detected else known - votes) / len(look.cameras)
    return decided(
        look,
        effect,
        evidence,
        counts=np.asarray((evidence.reached & frames).any(axis=1)),
        frames=spans(look, frames),
        reason=f"{votes} of {len(look.cameras)} cameras {what}; {known} could tell",
        cost=cost,
        sure=max(confidence(evidence), 0.5) * sure if known else 0.0,
        figures=figures,
    )
