"""The effects that one frame enables, and its settings for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from decogs.formats.splats import FloatArray

from ..change.masks import BoolArray, FrameMask
from ..settings.encode import EncodeSettings
from .building import disable
from .moving_regions import moving_regions


@dataclass(frozen=True)
class EnabledEffects:
    """What a frame is trained for: effects by name, the settings without the others, and where things move.

    ``moving``: of each view, the pixels (H, W) in and around what moves; None where the whole frame is trained alike.
    """

    effects: tuple[str, ...]
    settings: EncodeSettings
    moving: Sequence[BoolArray] | None


def enabled_effects(
    settings: EncodeSettings,
    pictures: Sequence[FloatArray],
    references: Sequence[FloatArray],
    masks: Sequence[FrameMask],
    *,
    threads: int = 1,
) -> EnabledEffects:
    """Those of ``settings``' effects that a changed frame calls for: all where something moves, else light alone.

    ``pictures``, ``references``: those of the frame, (3, H, W) each.
    """
    effects = settings.frame_effects
    moving = moving_regions(pictures, references, masks, threads=threads)
    if moving is not None:
        # Moving objects change their shading: without colours workbench_drift loses half a dB in moving regions.
        return EnabledEffects(effects, settings, moving)
    light = tuple(name for name in effects if name == "appearance_change")
    return EnabledEffects(light, disable(settings, set(effects) - set(light)), None)
