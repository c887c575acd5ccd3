"""The names of effects, in the order in which they are enabled, and the cameras that are corrected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from decogs.codec.packets.corrections import LampWave

from .checked import Checked, Within

FRAME_EFFECTS = ("motion", "appearance_change", "emergence", "disappearance")
"""Effects that every frame decides about."""

CAMERA_EFFECTS = (
    *("colour_mismatch", "exposure_drift", "white_balance_drift", "camera_shake", "lamp_flicker", "lens_distortion"),
)
"""Drift and mismatch of single cameras, compensated before other effects are detected."""

KEYFRAME_EFFECTS = ("view_dependence", "lens_falloff")
"""Effects that the keyframe decides about."""

RIG_EFFECTS = ("rolling_shutter",)
"""Effects that the rig's files tell."""

EFFECT_NAMES = (*FRAME_EFFECTS, *CAMERA_EFFECTS, *KEYFRAME_EFFECTS, *RIG_EFFECTS, "sensor_noise")

WITHDRAWN = {"high_dynamic_range": "an encode always clips at white"}
"""Former names, and why they went."""

EFFECT_BASES = ("auto", "all", "none")
"""Bases of a choice: the detected effects, every effect, or none."""

PRESET_EFFECTS = (*FRAME_EFFECTS, *KEYFRAME_EFFECTS, *RIG_EFFECTS)
"""Effects of what the cameras see, which frames and the keyframe decide about; those of a preset by itself."""


Turns = Annotated[float, Within(-1, 1)]


@dataclass(frozen=True)
class CorrectionSettings(Checked):
    """The cameras whose drift is compensated, by name; each one is a little slower."""

    exposure: tuple[str, ...] = ()  # cameras whose exposure drifts
    white_balance: tuple[str, ...] = ()  # cameras whose white balance drifts
    shake: tuple[str, ...] = ()  # cameras that rotate about their centre
    lens: Mapping[str, Annotated[float, Within(-10, 10)]] = field(default_factory=dict)  # k1 that calibration lacks
    lamps: Mapping[str, LampWave] = field(default_factory=dict)  # that flicker over the rows of a camera's pictures
    lamp_phases: Mapping[str, Turns] = field(default_factory=dict)  # of those at the rig's frame 0
    match_colours: bool = False  # constant differences between all cameras, too
    standing_bands: bool = False  # bands of lamps that stand still in their pictures, where the frame rate makes them
    falloff: bool = True  # darker borders of their pictures, where they surely are
    rolling_shutter: bool = True  # rows that are read one after the other, where the rig or lamps tell a readout

    @property
    def are_constant(self) -> bool:
        """Whether differences that cameras have in every frame alike are looked for."""
        return self.match_colours or self.falloff or self.standing_bands
