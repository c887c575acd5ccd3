"""The effects that one frame enables, and its settings for them."""

from __future__ import annotations

from collections.abc import Sequence

from decogs.formats.splats import FloatArray

from ..change.masks import FrameMask
from ..settings.encode import EncodeSettings
from .building import disable
from .frame_effects import frame_effects


def enabled_effects(
    settings: EncodeSettings,
    pictures: Sequence[FloatArray],
    references: Sequence[FloatArray],
    masks: Sequence[FrameMask],
    *,
    threads: int = 1,
) -> tuple[tuple[str, ...], EncodeSettings]:
    """The names of ``settings``' effects that are detected in a frame, and the settings without the others.

    ``pictures``, ``references``: those of the frame, (3, H, W) each.
    """
    effects = settings.frame_effects
    found = frame_effects(pictures, references, masks, threads=threads)
    # Moving objects change their shading: without colours workbench_drift loses half a dB in moving regions.
    disabled = [] if found.motion else [name for name in effects if not getattr(found, name)]
    return tuple(name for name in effects if name not in disabled), disable(settings, disabled)
