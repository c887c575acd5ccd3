"""The effects a scene may call for, and how a rig's pictures tell, before any 3D model exists.

Every effect is one module with one class that keeps the protocol of ``effect.py``: ``evidence`` turns the look at the
rig into figures per camera and frame, ``decide`` turns these into a decision with its reason and cost, ``enabled`` and
``disabled`` turn that into what an encode does (`building`). A new effect is one new module and one entry in
``EFFECTS``; one that a decoder has to know has its coded form in `codec`. What effects measure alike is measured once,
by the look (``look.py``): gains of light (``light.py``), the motion of the camera (``registration.py``), what changed
from frame to frame (``changes.py``), points that neighbouring cameras share (``matches.py``). ``frame_look.py`` says
the same of one frame of one view, in milliseconds, for the encoder's loop. What was measured, and what was rejected, is
in ``DESIGN.md``.
"""

from ..settings.effects import EFFECT_NAMES, FRAME_EFFECTS, PRESET_EFFECTS
from .appearance_change import AppearanceChange
from .building import AUTO, EffectChoice, disable, with_effects
from .camera_shake import CameraShake
from .disappearance import Disappearance
from .effect import Decision, Effect, Evidence
from .emergence import Emergence
from .exposure_drift import ExposureDrift
from .frame_look import frame_effects
from .high_dynamic_range import HighDynamicRange
from .lens_distortion import LensDistortion
from .look import Look, look_at
from .motion import Motion
from .sensor_noise import SensorNoise
from .view_dependence import ViewDependence
from .white_balance_drift import WhiteBalanceDrift

__all__ = [
    "AUTO",
    "EFFECTS",
    "EFFECT_NAMES",
    "FRAME_EFFECTS",
    "PRESET_EFFECTS",
    "Decision",
    "Effect",
    "EffectChoice",
    "Evidence",
    "Look",
    "disable",
    "frame_effects",
    "look_at",
    "with_effects",
]

EFFECTS: tuple[Effect, ...] = (
    Motion(),
    AppearanceChange(),
    Emergence(),
    Disappearance(),
    ExposureDrift(),
    WhiteBalanceDrift(),
    CameraShake(),
    LensDistortion(),
    ViewDependence(),
    SensorNoise(),
    HighDynamicRange(),
)
"""All effects, in the order in which they are shown."""
