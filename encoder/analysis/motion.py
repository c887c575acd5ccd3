"""Motion: restructured pixels, whose content no change of light explains."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..settings.encode import EncodeSettings
from .changes import WINDOW_PIXELS
from .effect import Decision, Effect, Evidence, decided, in_doubt, seen_together, spans
from .rig_statistics import RigStatistics

LIMIT = 0.15
"""Restructured share of nearby changes: the geometric mean of its values for light alone and for motion."""

PAUSE = 2
"""Frames without evidence that do not end a span: motion pauses where it reverses."""

_LIGHT_THRESHOLD = 0.4
"""Factor of the significance threshold where light alone changes: many Gaussians change, each of them hardly
visibly. candle: .036 / .056 / .112 (this is .072 of standard's .18) give 12.1 / 10.8 /
8.0 kB a frame and, where light changes, 31.91 / 31.94 / 31.89 dB."""

_LIGHT_ITERATIONS = 0.6
"""Smallest factor of a frame's iterations where light alone changes (`IterationSettings.min_factor`): candle takes 1.3
CPU-s a frame instead of 1.7 and loses .02 dB where light changes."""


class Motion(Effect):
    """Evidence: restructured share of the changed pixels around restructured ones.

    A moving body and the edges of its shadow are restructured. Under a change of light alone, the few restructured
    pixels (clipped highlights, a flame's rim) lie inside a large explained change. Restructured areas below one window
    (49 pixels) do not count.
    """

    name = "motion"

    def evidence(self, stats: RigStatistics) -> Evidence:
        restructured = np.stack([shares.restructured for shares in stats.changes])
        near = np.stack([shares.near for shares in stats.changes])
        pixels = np.array([[camera.width * camera.height] for camera in stats.cameras])
        share = restructured / np.maximum(near, 1e-9)
        share[restructured * pixels < WINDOW_PIXELS] = 0
        details = {"restructured": restructured * 100}
        return Evidence(share * 100, "% restructured", LIMIT * 100, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        area = float(np.nan_to_num(evidence.details["restructured"]).max())
        return decide_by_change(
            stats,
            self,
            evidence,
            reason=f"up to {area:.2g} % of a picture is restructured between two frames; light cannot explain it",
            cost="training and coding of positions and rotations: 8 kB and 0.8 CPU-s a frame (measured on workbench)",
            figures={"restructured_percent": area},
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """No warm start, no training of geometry; a lower significance threshold and fewer steps for light alone."""
        frame = settings.frame
        rates = replace(frame.rates, means=0.0, log_scales=0.0, quaternions=0.0)
        significance = replace(frame.significance, threshold=_LIGHT_THRESHOLD * frame.significance.threshold)
        adaptive = frame.adaptive_iterations
        pace = replace(adaptive, min_factor=min(_LIGHT_ITERATIONS, adaptive.max_factor))
        return replace(
            settings,
            frame=replace(
                frame, cache=None, warm_start=0.0, rates=rates, significance=significance, adaptive_iterations=pace
            ),
        )


def decide_by_change(
    stats: RigStatistics, effect: Effect, evidence: Evidence, *, reason: str, cost: str, figures: Mapping[str, Any]
) -> Decision:
    """Detected in frames with evidence in two cameras, and in all frames if every camera shakes."""
    doubt = in_doubt(stats, evidence)
    frames = np.full(len(stats.frames), doubt) | seen_together(evidence)
    return decided(
        stats,
        effect,
        evidence,
        counts=np.any((evidence.reached & frames) | doubt, axis=1),
        frames=spans(stats, frames, gap=PAUSE),
        reason="undetermined, so assumed: every camera shakes" if doubt else reason,
        cost=cost,
        figures=figures,
    )
