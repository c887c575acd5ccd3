"""The effects that one frame enables, and its settings for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..change.masks import BoolArray
from ..settings.encode import EncodeSettings
from .building import disable


@dataclass(frozen=True)
class EnabledEffects:
    """What a frame is trained for: effects by name, the settings without the others, and where things move.

    ``moving``: of each view, the pixels (H, W) in and around what moves; None where the whole frame is trained alike.
    """

    effects: tuple[str, ...]
    settings: EncodeSettings
    moving: Sequence[BoolArray] | None


def enabled_effects(settings: EncodeSettings, moving: Sequence[BoolArray] | None) -> EnabledEffects:
    """Those of ``settings``' effects that a changed frame calls for: all where something moves, else light alone.

    ``moving``: the frame's `moving_regions`.
    """
    effects = settings.frame_effects
    if moving is not None:
        # Moving objects change their shading: without colours workbench_drift loses half a dB in moving regions.
        return EnabledEffects(effects, settings, moving)
    light = tuple(name for name in effects if name == "appearance_change")
    return EnabledEffects(light, disable(settings, set(effects) - set(light)), None)
