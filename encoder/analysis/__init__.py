"""Effects of a scene and its cameras: what an encode enables, detected from a rig's pictures before any training.

An effect of the cameras is a module with one class that implements the protocol of ``effect.py``: ``evidence`` derives
figures per camera and frame from the rig's statistics, ``decide`` a decision with its reason and cost from these,
``enabled`` and ``disabled`` the settings of an encode (`building` lists them). ``rig_statistics.py`` makes the
measurements that effects share: gains of light (``light.py``), camera motion (``registration.py``), points that
neighbouring cameras share (``matches.py``). Effects of what the cameras see (``content.py``) are decided about frame by
frame, in the encoder's loop (``enabled.py``). An effect that a decoder has to know has its coded form in `codec`.
``DESIGN.md`` has measurements and rejected variants.
"""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from ..settings.effects import (
        EFFECT_NAMES as EFFECT_NAMES,
    )
    from ..settings.effects import (
        FRAME_EFFECTS as FRAME_EFFECTS,
    )
    from ..settings.effects import (
        PRESET_EFFECTS as PRESET_EFFECTS,
    )
    from .building import (
        AUTO as AUTO,
    )
    from .building import (
        EFFECTS as EFFECTS,
    )
    from .building import (
        EffectChoice as EffectChoice,
    )
    from .building import (
        disable as disable,
    )
    from .building import (
        effect_choice as effect_choice,
    )
    from .building import (
        with_effects as with_effects,
    )
    from .effect import Decision as Decision
    from .effect import Effect as Effect
    from .effect import Evidence as Evidence

_HOMES = {
    "EFFECT_NAMES": ".settings.effects",
    "FRAME_EFFECTS": ".settings.effects",
    "PRESET_EFFECTS": ".settings.effects",
    "AUTO": "building",
    "EFFECTS": "building",
    "EffectChoice": "building",
    "disable": "building",
    "effect_choice": "building",
    "with_effects": "building",
    "Decision": "effect",
    "Effect": "effect",
    "Evidence": "effect",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
