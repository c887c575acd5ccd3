"""Lens fall-off: pictures that are darker towards their border. An encode's keyframe decides; the analysis shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.decoder.cameras.lens import Undistortion
from decogs.rig.check.rig_statistics import RigStatistics
from decogs.rig.pictures.ingest import View

from ..input.compensation.falloff import MIN_LOSS, find_falloff
from ..keyframe.first_points import first_points
from ..settings.encode import EncodeSettings
from .effect import Decision, Evidence, cameras_beyond, make_decision, reason_of

_MOST_POINTS = 20_000
"""Of the plane sweep: the fit takes less than half as many."""


class LensFalloff:
    """Cameras whose pictures surely darken towards their border."""

    name = "lens_falloff"

    def evidence(self, stats: RigStatistics) -> Evidence:
        """Share of the light that is lost in the first picture's corners, where it is sure; else 0."""
        views, pictures = [], []
        for camera, recorded in zip(stats.cameras, stats.pictures, strict=True):
            lens = Undistortion(camera)
            valid = lens.valid
            views.append(View(camera, lens.pinhole, None if valid.all() else valid.astype(np.float32)))
            pictures.append(lens.apply(recorded[0]).astype(np.float32) / np.float32(255))
        points = first_points(
            [view.pinhole for view in views], pictures, recorded=[view.recorded for view in views], cap=_MOST_POINTS
        )
        planes = [np.ascontiguousarray(picture.transpose(2, 0, 1)) for picture in pictures]
        found = find_falloff(views, planes, points.xyz, points.seen)
        known = np.isfinite(found.deviation)
        values = np.full((len(views), len(stats.frames)), np.nan)
        values[:, 0] = np.where(known, np.where(found.is_sure, 100 * found.losses, 0.0), np.nan)
        details = {"loss": np.full_like(values, np.nan), "deviation": np.full_like(values, np.nan)}
        details["loss"][:, 0] = np.where(known, 100 * found.losses, np.nan)
        at_deviation = replace(found, k=found.deviation).losses
        details["deviation"][:, 0] = np.where(known, 100 * at_deviation, np.nan)
        return Evidence(values, "% of the corners' light", 100 * MIN_LOSS, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        return make_decision(
            stats,
            self,
            evidence,
            counts=cameras_beyond(evidence),
            reason=reason_of(
                evidence,
                f"corners have up to {evidence.peak:.0f} % less light than the middle, as other cameras show them",
                "too few points are shared by three cameras",
            ),
            cost=f"corners lose up to {evidence.peak:.0f} % of their light, new views 2 to 5 dB if that stays "
            "(an encode takes it out, 1 number per camera); a smaller aperture or a camera's own correction avoids it",
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        return self._with(settings, is_sought=True)

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return self._with(settings, is_sought=False)

    def _with(self, settings: EncodeSettings, *, is_sought: bool) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, falloff=is_sought))
