"""The effects, one object each (`effect` has their protocol)."""

from __future__ import annotations

from .appearance_change import AppearanceChange
from .camera_shake import CameraShake
from .colour_mismatch import ColourMismatch
from .disappearance import Disappearance
from .effect import Effect
from .emergence import Emergence
from .exposure_drift import ExposureDrift
from .high_dynamic_range import HighDynamicRange
from .lens_distortion import LensDistortion
from .motion import Motion
from .sensor_noise import SensorNoise
from .view_dependence import ViewDependence
from .white_balance_drift import WhiteBalanceDrift

EFFECTS: tuple[Effect, ...] = (
    Motion(),
    AppearanceChange(),
    Emergence(),
    Disappearance(),
    ColourMismatch(),
    ExposureDrift(),
    WhiteBalanceDrift(),
    CameraShake(),
    LensDistortion(),
    ViewDependence(),
    SensorNoise(),
    HighDynamicRange(),
)
"""All effects, in the order in which they are shown."""
