"""Exposure drift: a camera's whole picture grows brighter or darker, unlike other cameras' pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, decided, one_span, stated
from .light import EXPOSURE_LIMIT, FRAME_LIMIT
from .rig_statistics import RigStatistics


class ExposureDrift:
    """Cameras whose exposure drifts."""

    name = "exposure_drift"

    def evidence(self, stats: RigStatistics) -> Evidence:
        gains = {"gain": np.expm1(stats.light.gains[..., 0]) * 100}
        return Evidence(stats.light.exposure * 100, "% gain", EXPOSURE_LIMIT * 100, gains)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        drifting = cameras_beyond(evidence)
        gains = np.nan_to_num(stats.light.gains[..., 0])
        return decided(
            stats,
            self,
            evidence,
            counts=drifting,
            frames=one_span(stats, np.any(np.abs(gains[drifting]) >= FRAME_LIMIT, axis=0)),
            reason=stated(
                evidence,
                f"exposure drifts by up to {evidence.peak:.1f} %, uniformly over a camera's picture",
                "too few points are shared by three cameras",
            ),
            cost=f"1 number per camera and frame, about {2 * drifting.sum()} bytes a frame (estimated); "
            "one multiplication per pixel",
            figures={"gain": {stats.names[k]: np.exp(gains[k]).tolist() for k in np.flatnonzero(drifting)}},
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, exposure=decision.cameras))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, exposure=()))
