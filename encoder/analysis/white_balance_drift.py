"""White-balance drift: a camera's red or blue drifts against green in its whole picture, unlike other cameras'."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, decided, one_span, stated
from .light import FRAME_LIMIT, WHITE_BALANCE_LIMIT
from .rig_statistics import RigStatistics


class WhiteBalanceDrift:
    """Cameras whose white balance drifts."""

    name = "white_balance_drift"

    def evidence(self, stats: RigStatistics) -> Evidence:
        gains = {"red": np.expm1(stats.light.gains[..., 1]) * 100, "blue": np.expm1(stats.light.gains[..., 2]) * 100}
        return Evidence(stats.light.white_balance * 100, "% gain", WHITE_BALANCE_LIMIT * 100, gains)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        drifting = cameras_beyond(evidence)
        gains = np.nan_to_num(stats.light.gains[..., 1:])
        return decided(
            stats,
            self,
            evidence,
            counts=drifting,
            frames=one_span(stats, np.any(np.abs(gains[drifting]) >= FRAME_LIMIT, axis=(0, 2))),
            reason=stated(
                evidence,
                f"red or blue drifts by up to {evidence.peak:.1f} % against green, uniformly over a camera's picture",
                "too few points are shared by three cameras",
            ),
            cost=f"2 numbers per camera and frame, about {4 * drifting.sum()} bytes a frame (estimated); "
            "two multiplications per pixel",
            figures={"red_blue": {stats.names[k]: np.exp(gains[k]).tolist() for k in np.flatnonzero(drifting)}},
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, white_balance=decision.cameras))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, white_balance=()))
