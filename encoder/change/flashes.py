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

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from decogs.formats.splats import FloatArray

from ..settings.frame import MaskSettings
from .masks import (
    CLEAR_CHANGE_LEVELS,
    MAX_NOISE_FRACTION,
    MaskMemory,
    PixelChange,
    difference_mask,
    share,
    usable_views,
)

_MIN_FLASH_FRACTION = 0.5
"""Least fraction of changed pixels in a flash."""
_MAX_RETURN_FRACTION = 0.25
"""Largest fraction of pixels that differ from before after a flash: motion continues."""
MAX_FLASH_FRAMES = 8
"""Frames after which a light counts as permanent."""


def changes_most(memory: MaskMemory, changes: Sequence[PixelChange]) -> bool:
    """Whether nearly everything has changed since it was trained."""
    used, shares = usable_views(changes), memory.shares([change.raw for change in changes])
    return bool(used) and float(np.mean([shares[index] for index in used])) > _MIN_FLASH_FRACTION


def may_be_flash(memory: MaskMemory, pictures: Sequence[FloatArray], settings: MaskSettings) -> bool:
    """Whether nearly everything has changed since the frame before, and not only since it was trained."""
    return memory.changed_fraction(pictures, memory.previous, settings) > _MIN_FLASH_FRACTION


def matches(memory: MaskMemory, pictures: Sequence[FloatArray], settings: MaskSettings) -> bool:
    """Whether the ``pictures`` (3, H, W) of a frame are again those before a flash, whose ``memory`` was kept."""
    return memory.changed_fraction(pictures, memory.references, settings) < _MAX_RETURN_FRACTION


def is_missed(
    memory: MaskMemory,
    pictures: Sequence[FloatArray],
    render: Callable[[], Sequence[FloatArray]],
    changes: Sequence[PixelChange],
) -> bool:
    """Whether most pixels clearly changed and the scene, which ``render`` draws, misses them: no change was found."""
    used = usable_views(changes)
    if not used or any(change.raw.any() for change in changes):
        return False
    clearly = partial(difference_mask, threshold=CLEAR_CHANGE_LEVELS)
    rendered = render()
    missed = [
        share(clearly(pictures[i], memory.references[i]) & clearly(pictures[i], rendered[i]), memory.recorded[i])
        for i in used
    ]
    return float(np.median(missed)) > MAX_NOISE_FRACTION
