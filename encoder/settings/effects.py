"""The names of effects, in the order in which they are looked for and shown."""

from __future__ import annotations

FRAME_EFFECTS = ("motion", "appearance_change", "emergence", "disappearance")
"""What a frame may call for; every frame is asked anew."""

CAMERA_EFFECTS = ("colour_mismatch", "exposure_drift", "white_balance_drift", "camera_shake", "lens_distortion")
"""Faults of single cameras, undone before anything else is looked at."""

EFFECT_NAMES = (*FRAME_EFFECTS, *CAMERA_EFFECTS, "view_dependence", "sensor_noise", "high_dynamic_range")

EFFECT_BASES = ("auto", "all", "none")
"""What names are added to and taken from: what the scene calls for, every effect, or no effect."""

PRESET_EFFECTS = (*FRAME_EFFECTS, "view_dependence")
"""What a preset builds in every frame when nobody says otherwise and no scene is looked at."""
