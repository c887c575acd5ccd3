"""Everything that can be set, and the named sets of it.

A preset is a starting point; every field says on its line which way is slower.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from decogs.formats.errors import UsageError

from .encode import EncodeSettings
from .frame import (
    EmergenceSettings,
    FocusWeights,
    FrameSettings,
    IterationSettings,
    MaskSettings,
    SelectionSettings,
    SignificanceSettings,
)
from .keyframe import KeyframeSettings


def _better(
    settings: EncodeSettings, *, keyframe: Mapping[str, Any], frame: Mapping[str, Any], **own: Any
) -> EncodeSettings:
    """The same settings with some of the keyframe's, of later frames' and of its own replaced."""
    return replace(
        settings, keyframe=replace(settings.keyframe, **keyframe), frame=replace(settings.frame, **frame), **own
    )


_LIVE = EncodeSettings(
    keyframe=KeyframeSettings(iterations=250, cap=30_000, sh_degree=1, few_views_dissimilarity=0.02, surroundings=0.5),
    frame=FrameSettings(
        masks=MaskSettings(
            threshold=10.0,
            radius_fraction=0.018,
            speck_area=8,
            since_trained=True,
            light_threshold=4.0,
        ),
        joint_iterations=30,
        warm_start=1.0,
        grow_fraction=0.003,
        focus=FocusWeights(dissimilarity=0.05),
        beta1=0.7,
        beta2=0.99,
        adaptive_iterations=IterationSettings(usual_miss=0.15),
        significance=SignificanceSettings(
            threshold=0.15,
            rd_lambda=5e-3,
            colour_rd_lambda=1.25e-3,
        ),
        emergence=EmergenceSettings(max_rays=500),
    ),
)
_DRAFT = _better(_LIVE, keyframe={"iterations": 500, "cap": 40_000}, frame={"joint_iterations": 60})
_STANDARD = _better(_DRAFT, keyframe={"iterations": 1500, "cap": 52_000}, frame={"joint_iterations": 120})
_HIGH = _better(_STANDARD, keyframe={}, frame={"joint_iterations": 250})
_ARCHIVE = _better(
    _HIGH,
    keyframe={},
    frame={
        "joint_iterations": 400,
        "significance": SignificanceSettings(
            threshold=0.034,
            rd_lambda=5e-4,
            colour_rd_lambda=1.25e-4,
        ),
    },
    lattice_scale=0.7,
)

LADDER = ("live", "draft", "standard", "high", "archive")
"""Presets from fast to slow; each is the one before it with some settings made slower and larger."""

PRESETS: dict[str, EncodeSettings] = {
    **dict(zip(LADDER, (_LIVE, _DRAFT, _STANDARD, _HIGH, _ARCHIVE), strict=True)),
    "paper": EncodeSettings(
        method="paper",
        keyframe=KeyframeSettings(iterations=3000, sh_degree=1),
        frame=FrameSettings(
            selection=SelectionSettings(rule="paper"),
            focus=FocusWeights(over="picture"),
            emergence=EmergenceSettings(max_seeds=0),
        ),
    ),
}
"""The ladder (measured in report/curve.md), and ``paper``: its numbers wherever it gives them."""


def preset(name: str) -> EncodeSettings:
    """The settings of that name; raises UsageError for an unknown one."""
    if name not in PRESETS:
        raise UsageError(f"`settings` {name}: there is no such preset; choose from {', '.join(PRESETS)}")
    return PRESETS[name]
