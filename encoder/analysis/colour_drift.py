"""Drift of exposure or white balance: a camera's whole picture changes brightness or tint, unlike other cameras'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from decogs.rig.check.light import EXPOSURE_LIMIT, FRAME_LIMIT, WHITE_BALANCE_LIMIT, Light
from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import F64, Decision, Evidence, cameras_beyond, make_decision, one_span, reason_of


@dataclass(frozen=True)
class ColourDrift:
    """Cameras whose ``channels`` drift, of the logarithms in `Light.gains`.

    ``field``: the cameras' name in the settings of corrections. ``share``: how strong it is, by camera and frame.
    """

    name: str
    field: str
    channels: dict[str, int]
    what: str
    limit: float
    share: Callable[[Light], F64]

    def evidence(self, stats: RigStatistics) -> Evidence:
        gains = {name: np.expm1(stats.light.gains[..., k]) * 100 for name, k in self.channels.items()}
        return Evidence(self.share(stats.light) * 100, "% gain", self.limit * 100, gains)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        drifting = cameras_beyond(evidence)
        gains = {name: np.nan_to_num(stats.light.gains[..., k]) for name, k in self.channels.items()}
        strongest = np.max([np.abs(gain[drifting]).max(axis=0, initial=0) for gain in gains.values()], axis=0)
        return make_decision(
            stats,
            self,
            evidence,
            counts=drifting,
            frames=one_span(stats, strongest >= FRAME_LIMIT),
            reason=reason_of(
                evidence,
                f"{self.what} by up to {evidence.peak:.1f} %, uniformly over a camera's picture",
                "too few points are shared by three cameras",
            ),
            cost=f"about {2 * len(gains) * drifting.sum()} bytes a frame (estimated)",
            figures={
                name: {stats.names[k]: np.exp(gain[k]).tolist() for k in np.flatnonzero(drifting)}
                for name, gain in gains.items()
            },
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return self._with(settings, decision.cameras)

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return self._with(settings, ())

    def _with(self, settings: EncodeSettings, cameras: tuple[str, ...]) -> EncodeSettings:
        changed: dict[str, Any] = {self.field: cameras}
        return replace(settings, corrections=replace(settings.corrections, **changed))


EXPOSURE_DRIFT = ColourDrift(
    "exposure_drift", "exposure", {"gain": 0}, "exposure drifts", EXPOSURE_LIMIT, lambda light: light.exposure
)
WHITE_BALANCE_DRIFT = ColourDrift(
    "white_balance_drift",
    "white_balance",
    {"red": 1, "blue": 2},
    "red or blue drifts against green",
    WHITE_BALANCE_LIMIT,
    lambda light: light.white_balance,
)
