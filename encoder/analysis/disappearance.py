"""Something is gone in the end: it left the pictures, or went behind or into something else."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .effect import Decision, Evidence
from .emergence import IMBALANCE, decide_by_vote, none_without_motion
from .look import Look

if TYPE_CHECKING:
    from ..settings.encode import EncodeSettings


class Disappearance:
    """Something that is gone in the end."""

    name = "disappearance"

    def evidence(self, look: Look) -> Evidence:
        values = np.stack([arrivals.left for arrivals in look.arrivals])
        return Evidence(none_without_motion(look, values), "% left only", IMBALANCE)

    def decide(self, look: Look, evidence: Evidence) -> Decision:
        return decide_by_vote(
            look,
            self,
            evidence,
            what="show at their start what is gone at their end and went nowhere in the picture",
            cost="pruning in these frames: nothing to train, 1 bit a Gaussian before coding (estimated)",
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return settings

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """What has become faint stays."""
        return replace(settings, frame=replace(settings.frame, prune_opacity=0.0))
