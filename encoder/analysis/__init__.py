"""Effects of a scene and its cameras, detected from a rig's pictures before any 3D model exists.

Every effect is a module with one class that implements the protocol of ``effect.py``: ``evidence`` derives figures per
camera and frame from the rig's statistics, ``decide`` a decision with its reason and cost from these, ``enabled`` and
``disabled`` the settings of an encode (`building`). A new effect is a new module and an entry in ``every_effect.py``.
An effect that a decoder has to know has its coded form in `codec`. ``rig_statistics.py`` makes the measurements that
effects share: gains of light (``light.py``), camera motion (``registration.py``), changes from frame to frame
(``changes.py``), points that neighbouring cameras share (``matches.py``). ``frame_effects.py`` detects effects of one
frame of one view, in milliseconds, for the encoder's loop. ``DESIGN.md`` has measurements and rejected variants.
"""

from ..settings.effects import EFFECT_NAMES, FRAME_EFFECTS, PRESET_EFFECTS
from .building import AUTO, EffectChoice, disable, effect_choice, with_effects
from .effect import Decision, Effect, Evidence
from .every_effect import EFFECTS
from .frame_effects import frame_effects
from .rig_statistics import RigStatistics, gather_statistics

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
    "RigStatistics",
    "disable",
    "effect_choice",
    "frame_effects",
    "gather_statistics",
    "with_effects",
]
