"""Sensor noise: differences between successive pictures of a static scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, reason_of

_ROUNDING_LEVELS = 0.3
"""Deviation of rounding to 8 bits, in levels: 1 / sqrt 12, rounded up."""
_THRESHOLD_DEVIATIONS = 6
"""Least size of a change, in deviations of the difference of two pictures."""


class SensorNoise:
    """Noise between frames of static pixels."""

    name = "sensor_noise"

    def evidence(self, stats: RigStatistics) -> Evidence:
        return Evidence(stats.noise, "levels", _ROUNDING_LEVELS)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        noisy = cameras_beyond(evidence)
        thresholds = _THRESHOLD_DEVIATIONS * np.sqrt(2) * np.nan_to_num(evidence.camera_peaks)
        return make_decision(
            stats,
            self,
            evidence,
            counts=noisy,
            reason=reason_of(
                evidence,
                f"static pixels have noise of up to {evidence.peak:.2f} levels of 255 (standard deviation)",
                "no static pixels in two successive frames",
            ),
            cost=f"no bytes; a mask threshold of at least {thresholds.max():.1f} levels in the noisiest camera",
            figures={"min_threshold": {name: float(t) for name, t in zip(stats.names, thresholds, strict=True)}},
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        """Raises each camera's threshold above its noise; nothing, where the threshold is above it already."""
        if max(decision.figures["min_threshold"].values()) <= settings.frame.masks.threshold:
            return self.disabled(settings)
        masks = replace(settings.frame.masks, noise_multiple=float(_THRESHOLD_DEVIATIONS))
        return replace(settings, frame=replace(settings.frame, masks=masks))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        masks = replace(settings.frame.masks, noise_multiple=0.0)
        return replace(settings, frame=replace(settings.frame, masks=masks))
