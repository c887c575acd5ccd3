"""Effects of a scene and its cameras: what an encode enables, detected from a rig's pictures before any training.

An effect of the cameras is a module with one class that implements the protocol of ``effect.py``: ``evidence`` derives
figures per camera and frame from the rig's statistics, ``decide`` a decision with its reason and cost from these,
``enabled`` and ``disabled`` the settings of an encode (`building` lists them). ``rig_statistics.py`` makes the
measurements that effects share: gains of light (``light.py``), camera motion (``registration.py``), points that
neighbouring cameras share (``matches.py``). Effects of what the cameras see (``content.py``) are decided about frame by
frame, in the encoder's loop (``enabled.py``). An effect that a decoder has to know has its coded form in `codec`.
``DESIGN.md`` has measurements and rejected variants.
"""

from ..settings.effects import EFFECT_NAMES, FRAME_EFFECTS, PRESET_EFFECTS
from .building import AUTO, EFFECTS, EffectChoice, disable, effect_choice, with_effects
from .effect import Decision, Effect, Evidence
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
    "gather_statistics",
    "with_effects",
]
