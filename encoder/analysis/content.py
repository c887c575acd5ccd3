"""Effects of what the cameras see, and what an encode or a frame leaves out without each of them.

A frame decides about motion and light (`enabled`). With motion, it decides about emergence and disappearance while it
trains: new points are searched where views still miss a surface (`training/seeding.py`), and Gaussians go that became
transparent. The keyframe decides about view dependence (`keyframe/harmonics.py`) and about lenses that darken their
borders (`input/compensation/falloff.py`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..settings.encode import EncodeSettings

_LIGHT_THRESHOLD_FACTOR = 0.4
"""Factor of the significance threshold where light alone changes: many Gaussians change, each of them hardly
visibly. candle: .036 / .056 / .112 (this is .072 of standard's .18) give 12.1 / 10.8 /
8.0 kB a frame and, where light changes, 31.91 / 31.94 / 31.89 dB."""

_LIGHT_MIN_FACTOR = 0.6
"""Smallest factor of a frame's iterations where light alone changes (`IterationSettings.min_factor`): candle takes 1.3
CPU-s a frame instead of 1.7 and loses .02 dB where light changes."""


def _without_motion(settings: EncodeSettings) -> EncodeSettings:
    """No warm start, no training of geometry; a lower significance threshold and fewer steps for light alone."""
    frame = settings.frame
    rates = replace(frame.rates, means=0.0, log_scales=0.0, quaternions=0.0)
    significance = replace(frame.significance, threshold=_LIGHT_THRESHOLD_FACTOR * frame.significance.threshold)
    pace = replace(frame.adaptive_iterations, min_factor=_LIGHT_MIN_FACTOR)
    return replace(
        settings,
        frame=replace(frame, warm_start=0.0, rates=rates, significance=significance, adaptive_iterations=pace),
    )


def _without_appearance_change(settings: EncodeSettings) -> EncodeSettings:
    """Colours and opacities stay as they are."""
    rates = replace(settings.frame.rates, opacity_logits=0.0, sh_dc=0.0, sh_rest=0.0)
    return replace(settings, frame=replace(settings.frame, rates=rates))


def _without_emergence(settings: EncodeSettings) -> EncodeSettings:
    """Neither the search for emerging objects nor densification."""
    frame = settings.frame
    frame = replace(frame, grow_fraction=0.0, emergence=replace(frame.emergence, max_seeds=0))
    return replace(settings, frame=frame)


def _without_disappearance(settings: EncodeSettings) -> EncodeSettings:
    """Transparent Gaussians stay."""
    return replace(settings, frame=replace(settings.frame, prune_opacity=0.0))


def _without_view_dependence(settings: EncodeSettings) -> EncodeSettings:
    """One colour for all directions."""
    rates = replace(settings.frame.rates, sh_rest=0.0)
    keyframe = replace(settings.keyframe, sh_degree=0)
    return replace(settings, keyframe=keyframe, frame=replace(settings.frame, rates=rates))


WITHOUT: dict[str, Callable[[EncodeSettings], EncodeSettings]] = {
    "motion": _without_motion,
    "appearance_change": _without_appearance_change,
    "emergence": _without_emergence,
    "disappearance": _without_disappearance,
    "view_dependence": _without_view_dependence,
}
"""The settings without each of these effects."""
