"""What a single frame calls for, told from its masks in a few milliseconds a view, while the encode waits.

The same evidence as over a whole rig (`changes`), on the part of every picture in which the frame's masks lie, against
the picture on which each pixel was last trained. Only one thing is decided by it: whether light alone has changed, so
that nothing has to move. In doubt, and where a mask only says that an earlier frame was got wrong, things move. What
emerges and what disappears is not told by a single frame's changes; where something moves, training looks for both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.formats.splats import FloatArray

from ..masks import FrameMask
from .changes import U8, WINDOW_PIXELS, change_maps
from .motion import RESTRUCTURED_PERCENT
from .names import FRAME_EFFECTS

_NOISE = 1.0
"""Deviation of a picture in 8-bit levels that is taken for granted: masks have left out what is fainter."""
_EXPLAINED = 0.5
"""Least share of a mask that has to have changed since it was last trained for the change to tell anything."""


def frame_effects(
    current: Sequence[FloatArray], references: Sequence[FloatArray], masks: Sequence[FrameMask]
) -> tuple[str, ...]:
    """Names of the frame effects that training has to be ready for, given one (3, H, W) picture of every view.

    ``references``: what each pixel is compared with. All of them, unless no two views show anything that moves.
    """
    moving = 0
    for now, before, mask in zip(current, references, masks, strict=True):
        moving += mask.raw.any() and _moves(now, before, mask)
        if moving >= min(2, len(masks)):
            return FRAME_EFFECTS
    return ("appearance_change",)


def _moves(now: FloatArray, before: FloatArray, mask: FrameMask) -> bool:
    """Whether anything but light changes where a view's mask lies."""
    part = _bounds(mask)
    raw = mask.raw[part]
    maps = change_maps(_bytes(before, part), _bytes(now, part), _NOISE)
    if (raw & ~maps.changed).sum() > _EXPLAINED * raw.sum():
        return True
    restructured, near = int(maps.restructured.sum()), int(maps.near().sum())
    return restructured >= WINDOW_PIXELS and 100 * restructured >= RESTRUCTURED_PERCENT * near


def _bounds(mask: FrameMask) -> tuple[slice, slice]:
    """The smallest rectangle around the region of interest."""
    rows, columns = (np.flatnonzero(mask.dilated.any(axis=axis)) for axis in (1, 0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _bytes(picture: FloatArray, part: tuple[slice, slice]) -> U8:
    inside = picture[:, part[0], part[1]].transpose(1, 2, 0)
    return np.ascontiguousarray(np.rint(np.clip(inside, 0, 1) * 255).astype(np.uint8))
