"""A light that flashes: once it is over, the scene goes back to what it was, bit for bit.

A frame that changes nearly all of the pictures is followed like any other, since it may be a lamp that stays on. But
what was known before it is kept for some frames: when the pictures are as they were then, so is the scene. Training
alone takes many frames to undo what a flash did to every Gaussian at once: on the tests' rig 22.2 dB became 18.6 at the
flash, then 15.7, 20.4 and 20.8; now 22.2 at once.

The return is written as a keyframe, coded as the difference from the stream's first one. Rejected: leaving such frames
out (nothing tells a flash from a lamp before the next frame), and a delta (Gaussians that went do not come back under
their ids).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decogs.codec.state import State
from decogs.formats.splats import FloatArray

from .masks import FrameMask, MaskMemory, showing

_EVERYWHERE = 0.5
"""Share of the pixels whose change makes a frame one that may be a flash."""
_AS_BEFORE = 0.25
"""Share of the pixels that may differ from before when it is over: what moves goes on moving."""
_LONGEST = 8
"""Frames after which a light is there to stay."""


@dataclass(frozen=True)
class BeforeFlash:
    """What was known before the frame ``since`` changed nearly everything: the scene, its last motion, the masks."""

    since: int
    state: State
    motion: FloatArray
    masks: MaskMemory

    def is_over(self, pictures: Sequence[FloatArray]) -> bool:
        """Whether the pictures (3, H, W) of a frame are as they were."""
        return self.masks.share_changed(pictures) < _AS_BEFORE

    def stays(self, frame: int) -> bool:
        """Whether the light is no flash any more."""
        return frame - self.since > _LONGEST


def may_be_flash(masks: Sequence[FrameMask]) -> bool:
    """Whether nearly everything has changed."""
    seen = showing(masks)
    return bool(seen) and float(np.mean([masks[index].raw.mean() for index in seen])) > _EVERYWHERE
