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
from dataclasses import dataclass

import numpy as np

from decogs.codec.state import State
from decogs.formats.splats import FloatArray

from .masks import FrameMask, MaskMemory, showing

_EVERYWHERE = 0.5
"""Share of changed pixels from which on a frame may be a flash."""
_AS_BEFORE = 0.25
"""Share of pixels that may differ from before after a flash, since motion continues."""
_LONGEST = 8
"""Frames after which a light counts as permanent."""


@dataclass(frozen=True)
class BeforeFlash:
    """State before the frame ``since``, which changed nearly everything: the scene, its last motion, the masks."""

    since: int
    state: State
    motion: FloatArray
    masks: MaskMemory

    def is_over(self, pictures: Sequence[FloatArray]) -> bool:
        """Whether the pictures (3, H, W) of a frame match those before the flash."""
        return self.masks.changed_fraction(pictures) < _AS_BEFORE

    def stays(self, frame: int) -> bool:
        """Whether the light counts as permanent."""
        return frame - self.since > _LONGEST


def may_be_flash(masks: Sequence[FrameMask]) -> bool:
    """Whether nearly everything has changed."""
    seen = showing(masks)
    return bool(seen) and float(np.mean([masks[index].raw.mean() for index in seen])) > _EVERYWHERE
