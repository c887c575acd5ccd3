"""Lamp flicker: mains lamps over a rolling shutter, whose bands wander over a camera's pictures (`rig.check.lamps`)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from decogs.rig.check.lamps import MIN_AMPLITUDE
from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, reason_of


class LampFlicker:
    """Cameras whose rows show the pulse of mains lamps."""

    name = "lamp_flicker"

    def evidence(self, stats: RigStatistics) -> Evidence:
        shape = (len(stats.cameras), len(stats.frames))
        values, names = np.full(shape, np.nan), ("share", "ratio", "hertz", "readout_ms")
        details = {name: np.full(shape, np.nan) for name in names}
        for row, lamps in enumerate(stats.lamps):
            if lamps is None:
                continue
            values[row, 0] = 100 * lamps.amplitude if lamps.is_sure else 0.0
            each = (lamps.share, lamps.ratio, lamps.wave.hertz, 1000 * lamps.wave.readout)
            for name, value in zip(names, each, strict=True):
                details[name][row, 0] = value
        return Evidence(values, "% of light", 100 * MIN_AMPLITUDE, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        counts = cameras_beyond(evidence)
        cost, figures = "", dict[str, Any]()
        if counts.any():
            strongest = int(np.nan_to_num(evidence.values[:, 0]).argmax())
            hertz, readout = (evidence.details[name][:, 0] for name in ("hertz", "readout_ms"))
            mains = round(float(np.median(hertz[counts])) / 2)
            cost = (
                f"lamps at {2 * mains} Hz: {stats.names[strongest]} reads its rows in {abs(readout[strongest]):.1f} ms "
                f"and sees their light change by {evidence.peak:.0f} %; 4 bytes a camera and frame. "
                f"A shutter of 1/{2 * mains} or 1/{mains} s avoids it"
            )
            sure = {name: lamps for name, lamps in zip(stats.names, stats.lamps, strict=True) if lamps}
            sure = {name: sure[name] for name, count in zip(stats.names, counts, strict=True) if count}
            figures = {"lamps": {name: lamps.wave for name, lamps in sure.items()}}
            figures["lamp_phases"] = {name: lamps.phase for name, lamps in sure.items()}
        return make_decision(
            stats,
            self,
            evidence,
            counts=counts,
            reason=reason_of(
                evidence,
                f"rows' light changes by up to {evidence.peak:.1f} % at twice the mains' frequency",
                "fewer than five frames, no frame rate, or bands that would stand still",
            ),
            cost=cost,
            figures=figures,
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        found = {name: decision.figures.get(name, {}) for name in ("lamps", "lamp_phases")}
        return replace(settings, corrections=replace(settings.corrections, **found))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, lamps={}, lamp_phases={}))
