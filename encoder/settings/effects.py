"""The names of effects, in the order in which they are detected and shown."""

from __future__ import annotations

FRAME_EFFECTS = ("motion", "appearance_change", "emergence", "disappearance")
"""Effects that are detected frame by frame."""

CAMERA_EFFECTS = ("colour_mismatch", "exposure_drift", "white_balance_drift", "camera_shake", "lens_distortion")
"""Drift and mismatch of single cameras, compensated before other effects are detected."""

EFFECT_NAMES = (*FRAME_EFFECTS, *CAMERA_EFFECTS, "view_dependence", "sensor_noise", "high_dynamic_range")

EFFECT_BASES = ("auto", "all", "none")
"""Bases of a choice: the detected effects, every effect, or none."""

PRESET_EFFECTS = (*FRAME_EFFECTS, "view_dependence")
"""Effects that a preset enables in every frame unless effects are chosen or detected."""
