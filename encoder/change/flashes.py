"""Flashes of light: after a flash, the scene returns to its former state, bit for bit.

Training follows a frame that changes nearly all of the pictures, since a lamp may stay on. The encoder keeps the former
state for some frames and restores it once the pictures match it again. Training alone takes many frames to undo a
flash, which changes every Gaussian at once: on the tests' rig 22.2 dB became 18.6 at the flash, then 15.7, 20.4 and
20.8; now 22.2 immediately.

The return is a keyframe, coded as the difference from the stream's first one. Rejected: skipping such frames (a flash
cannot be distinguished from a lamp before the next frame), and a delta (removed Gaussians do not return with their
ids).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.formats.splats import FloatArray

from ..settings.frame import MaskSettings
from .masks import CLEARLY, MOST, MaskMemory, PixelChange, difference_mask, showing

_FLASH_SHARE = 0.5
"""Share of changed pixels from which on a frame may be a flash."""
_RETURN_SHARE = 0.25
"""Share of pixels that may differ from before after a flash, since motion continues."""
MAX_FLASH_FRAMES = 8
"""Frames after which a light counts as permanent."""


def may_be_flash(changes: Sequence[PixelChange]) -> bool:
    """Whether nearly everything has changed."""
    seen = showing(changes)
    return bool(seen) and float(np.mean([changes[index].raw.mean() for index in seen])) > _FLASH_SHARE


def matches(memory: MaskMemory, pictures: Sequence[FloatArray], settings: MaskSettings) -> bool:
    """Whether the ``pictures`` (3, H, W) of a frame are again those before a flash, whose ``memory`` was kept."""
    return memory.changed_fraction(pictures, settings) < _RETURN_SHARE


def is_missed(
    memory: MaskMemory, pictures: Sequence[FloatArray], rendered: Sequence[FloatArray], changes: Sequence[PixelChange]
) -> bool:
    """Whether most pixels clearly changed and the scene, as ``rendered``, misses them, though no change was found."""
    used = showing(changes)
    if not used or any(change.raw.any() for change in changes):
        return False
    missed = [
        (
            difference_mask(pictures[i], memory.references[i], CLEARLY)
            & difference_mask(pictures[i], rendered[i], CLEARLY)
        )
        for i in used
    ]
    return float(np.median([mask.mean() for mask in missed])) > MOST
