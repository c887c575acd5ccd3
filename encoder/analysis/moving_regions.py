"""Effects of one frame, detected from the masks' pictures in milliseconds per view, for the encoder's loop.

The measures are those of a clip (``changes.py``), inside each view's mask, at the size of the rig's statistics. A
doubtful case counts as motion: training resting positions costs time, not training moving ones costs quality.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..change.masks import BoolArray, FrameMask
from ..change.noise import picture_noise
from ..parallel import side_by_side
from . import appearance_change, motion
from .changes import WINDOW_PIXELS, change_maps
from .rig_statistics import MAX_PIXELS

_MIN_CHANGED = 4 * WINDOW_PIXELS
"""Least changed pixels of all views for a frame to be clear."""


@dataclass(frozen=True)
class FrameEffects:
    """Effects of a frame. Without ``motion`` only colours and opacities need training.

    ``emergence`` and ``disappearance`` cannot be detected from two pictures, so motion implies them. ``moving``: of
    each view, the pixels (H, W) in and around what moves; elsewhere light alone changes the picture.
    """

    motion: bool
    appearance_change: bool
    moving: Sequence[BoolArray] = field(default=(), compare=False)

    @property
    def emergence(self) -> bool:
        """Whether something may have come: with any motion."""
        return self.motion

    @property
    def disappearance(self) -> bool:
        """Whether something may have gone: with any motion."""
        return self.motion


@dataclass(frozen=True)
class _Pixels:
    """Pixel counts of one view: changed, restructured, and changed near restructured ones."""

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
    """Effects of a frame, from every view's picture (3, H, W) 0..1, its reference and its mask.

    Raises ValueError when they are not the same views.
    """
    with side_by_side(threads) as each:
        found = list(each(lambda view: _changes(*view), zip(current, previous, masks, strict=True)))
    moving = [region for _, region in found]
    views = [pixels for pixels, _ in found if pixels is not None]
    if not views:
        return FrameEffects(motion=False, appearance_change=False, moving=moving)
    # All views together count as one more, since views may be unclear one by one.
    together = _Pixels(*(sum(getattr(view, each.name) for view in views) for each in fields(_Pixels)))
    moves = together.changed < _MIN_CHANGED or any(view.moves for view in (*views, together))
    lit = any(v.changed - v.near >= appearance_change.LIMIT * max(v.changed, 1) for v in views)
    return FrameEffects(motion=moves, appearance_change=lit or not moves, moving=moving)


def _changes(current: FloatArray, previous: FloatArray, mask: FrameMask) -> tuple[_Pixels | None, BoolArray]:
    """A view's changes, None without any, and the pixels (H, W) in and around what moves."""
    moving = np.zeros(mask.raw.shape, np.bool_)
    if not mask.dilated.any():
        return None, moving
    scale = min(1.0, math.sqrt(MAX_PIXELS / mask.raw.size))
    part = _bounds(mask)
    maps = change_maps(
        _small(previous[:, part[0], part[1]], scale),
        _small(current[:, part[0], part[1]], scale),
        picture_noise(previous[1], current[1]),
    )
    around = maps.around(round(scale * mask.raw.shape[1]))
    moving[part] = _enlarged(around, moving[part].shape)
    return _Pixels(int(maps.changed.sum()), int(maps.restructured.sum()), int((maps.changed & around).sum())), moving


def _enlarged(region: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    height, width = shape
    return np.asarray(cv2.resize(region.view(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0)


def _bounds(mask: FrameMask) -> tuple[slice, slice]:
    rows, columns = (np.flatnonzero(mask.dilated.any(axis=axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def _small(picture: FloatArray, scale: float) -> NDArray[np.uint8]:
    """(3, H, W) 0..1 as (h, w, 3) levels."""
    levels = cv2.merge([np.ascontiguousarray(plane) for plane in picture])
    if scale < 1:
        levels = cv2.resize(levels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.convertScaleAbs(levels, alpha=255))
