"""Camera shake: the whole picture moves against the first frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.rig.check.registration import SHAKE_LIMIT_PIXELS
from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, one_span, reason_of


class CameraShake:
    """Cameras that do not stand still."""

    name = "camera_shake"

    def evidence(self, stats: RigStatistics) -> Evidence:
        return Evidence(np.stack([path.displacement for path in stats.paths]), "px", SHAKE_LIMIT_PIXELS)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        shaking = cameras_beyond(evidence)
        own = evidence.camera_peaks / np.array(stats.scales)
        largest = float(np.nan_to_num(own).max())
        return make_decision(
            stats,
            self,
            evidence,
            counts=shaking,
            frames=one_span(stats, np.any(evidence.reached[shaking], axis=0)),
            reason=reason_of(
                evidence,
                f"the static background shifts by up to {evidence.peak:.2f} px ({largest:.2f} px at full resolution)",
                "no camera's background can be registered to its first frame",
            ),
            cost=f"3 angles per shaking camera and frame, about {6 * shaking.sum()} bytes a frame (estimated); a pose "
            "gradient in every training step of these cameras",
            figures={
                "transforms": {
                    stats.names[k]: {"scale": stats.scales[k], "pixels": stats.paths[k].transforms.tolist()}
                    for k in np.flatnonzero(shaking)
                }
            },
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, shake=decision.cameras))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, shake=()))
