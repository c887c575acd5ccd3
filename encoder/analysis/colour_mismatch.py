"""Colour mismatch: cameras show the same surface brighter, darker or in another tint than others, in every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.rig.check.light import EXPOSURE_LIMIT
from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, reason_of


class ColourMismatch:
    """Cameras whose colours differ from the others' already in the first frame."""

    name = "colour_mismatch"

    def evidence(self, stats: RigStatistics) -> Evidence:
        shares = np.abs(stats.mismatch.shares).max(axis=1)
        # A drifting camera is compensated in every frame, the first one included.
        shares = np.where(stats.light.drifts, 0.0, shares)
        frames = len(stats.frames)
        gains = zip(("exposure", "red", "blue"), stats.mismatch.gains.T, strict=True)
        details = {name: np.repeat(np.expm1(gain)[:, None] * 100, frames, axis=1) for name, gain in gains}
        return Evidence(np.repeat(shares[:, None] * 100, frames, axis=1), "% gain", EXPOSURE_LIMIT * 100, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        different = cameras_beyond(evidence)
        return make_decision(
            stats,
            self,
            evidence,
            counts=different,
            reason=reason_of(
                evidence,
                f"gain against the other cameras is up to {evidence.peak:.1f} %, uniform over a camera's picture",
                "too few points are shared by three cameras",
            ),
            cost="3 numbers per camera in the header; one multiplication per pixel",
            figures={
                "gain": {stats.names[k]: np.exp(stats.mismatch.gains[k]).tolist() for k in different.nonzero()[0]}
            },
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        # Of all cameras: what is below the limit in some is found as well as what is above it in others.
        return replace(settings, corrections=replace(settings.corrections, match_colours=True))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, match_colours=False))
