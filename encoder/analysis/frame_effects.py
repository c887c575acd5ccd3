"""What one frame brings, determined from the masks' own pictures in milliseconds a view: for the encoder's loop.

The measure is that of the clip (``changes.py``), on the part of each view that its mask covers, at the size the clip is
looked at. Whatever is in doubt is motion: training positions that did not change costs time, not training those that
did costs the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..change.masks import FrameMask
from ..change.noise import picture_noise
from ..parallel import side_by_side
from . import appearance_change, motion
from .changes import WINDOW_PIXELS, change_maps
from .rig_statistics import MOST_PIXELS

_LEAST_CHANGED = 4 * WINDOW_PIXELS
"""Changed pixels of all views below which a frame is in doubt."""


@dataclass(frozen=True)
class FrameEffects:
    """What a frame may bring. Without ``motion`` only colours and opacities need training.

    ``emergence`` and ``disappearance`` are determined over a clip, not from two pictures: any motion may bring them.
    """

    motion: bool
    appearance_change: bool

    @property
    def emergence(self) -> bool:
        return self.motion

    @property
    def disappearance(self) -> bool:
        return self.motion


@dataclass(frozen=True)
class _Pixels:
    """Pixels of one view, at the size looked at: changed, restructured, and changed near restructured ones."""

    changed: int
    restructured: int
    near: int

    @property
    def moves(self) -> bool:
        return self.restructured >= max(motion.LIMIT * self.near, WINDOW_PIXELS)


def frame_effects(
    current: Sequence[FloatArray],
    previous: Sequence[FloatArray],
    masks: Sequence[FrameMask],
    *,
    threads: int = 1,
) -> FrameEffects:
    """What a frame brings, from every view's picture (3, H, W) 0..1, the one it is compared with, and its mask.

    Raises ValueError when they are not the same views.
    """
    changed = [view for view in zip(current, previous, masks, strict=True) if view[2].dilated.any()]
    with side_by_side(threads) as each:
        views = list(each(lambda view: _pixels(*view), changed))
    if not views:
        return FrameEffects(motion=False, appearance_change=False)
    # Many little doubts are one: all views together count as one more.
    together = _Pixels(*(sum(getattr(view, field.name) for view in views) for field in fields(_Pixels)))
    moves = together.changed < _LEAST_CHANGED or any(view.moves for view in (*views, together))
    lit = any(v.changed - v.near >= appearance_change.LIMIT * max(v.changed, 1) for v in views)
    return FrameEffects(motion=moves, appearance_change=lit or not moves)


def _pixels(current: FloatArray, previous: FloatArray, mask: FrameMask) -> _Pixels:
    scale = min(1.0, math.sqrt(MOST_PIXELS / mask.raw.size))
    part = _bounds(mask)
    maps = change_maps(
        _small(previous[:, part[0], part[1]], scale),
        _small(current[:, part[0], part[1]], scale),
        picture_noise(previous[1], current[1]),
    )
    near = maps.near(round(scale * mask.raw.shape[1]))
    return _Pixels(int(maps.changed.sum()), int(maps.restructured.sum()), int(near.sum()))


def _bounds(mask: FrameMask) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.dilated.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _small(picture: FloatArray, scale: float) -> NDArray[np.uint8]:
    """(3, H, W) 0..1 as (h, w, 3) levels."""
    levels = cv2.merge([np.ascontiguousarray(plane) for plane in picture])
    if scale < 1:
        levels = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.convertScaleAbs(levels, alpha=255))
