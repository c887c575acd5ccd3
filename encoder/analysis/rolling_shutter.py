"""Rolling shutter: rows that a camera reads one after the other, as the rig's files or bands of lamps tell. It is not
guessed from motion: what all cameras share of it cannot be seen, and what differs between them looks like motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, reason_of

_LIMIT_MILLISECONDS = 1.0
"""Readout from which it counts: what crosses a picture in a second then moves by a thousandth of it."""


class RollingShutter:
    """Cameras whose rows are read one after the other."""

    name = "rolling_shutter"

    def evidence(self, stats: RigStatistics) -> Evidence:
        values = np.full((len(stats.cameras), len(stats.frames)), np.nan)
        values[:, 0] = 1000 * np.abs(stats.readouts)
        return Evidence(values, "ms of readout", _LIMIT_MILLISECONDS)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        from_below = sum(bool(readout < 0) for readout in stats.readouts)
        return make_decision(
            stats,
            self,
            evidence,
            counts=cameras_beyond(evidence),
            reason=reason_of(
                evidence,
                f"readouts of up to {evidence.peak:.1f} ms, {from_below} cameras read from below",
                "neither the rig (`readout` in rig.json) nor lamps tell a camera's readout",
            ),
            cost="no bytes; what moves is drawn at each row's time in later frames, some dB there (a fifth more CPU)",
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return self._with(settings, is_followed=True)

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return self._with(settings, is_followed=False)

    def _with(self, settings: EncodeSettings, *, is_followed: bool) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, rolling_shutter=is_followed))
