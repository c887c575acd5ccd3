"""Where things move in one frame, as opposed to changing light; milliseconds per view.

Pictures and their references are compared inside each view's mask, at the size of the rig's statistics (`changes`). A
doubtful case counts as motion: training resting positions costs time, not training moving ones costs quality.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray
from decogs.rig.check.rig_statistics import MAX_PIXELS
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.noise import picture_noise

from ..change.masks import BoolArray, FrameMask
from .changes import WINDOW_PIXELS, change_maps

_MOVING_SHARE = 0.15
"""Restructured share of nearby changes from which something moves: the geometric mean of its largest value for light
alone (9.5 %, candle) and its least for motion (24 %, real rigs)."""
_MIN_CHANGED_PIXELS = 4 * WINDOW_PIXELS
"""Least changed pixels of all views for a frame to be clear."""


@dataclass(frozen=True)
class _Pixels:
    """Pixel counts of one view: changed, restructured, and changed near restructured ones.

    Under a change of light alone, the few restructured pixels (clipped highlights, a flame's rim) lie inside a large
    explained change.
    """

    changed: int
    restructured: int
    near: int

    @property
    def moves(self) -> bool:
        return self.restructured >= max(_MOVING_SHARE * self.near, WINDOW_PIXELS)


def moving_regions(
    current: Sequence[FloatArray],
    previous: Sequence[FloatArray],
    masks: Sequence[FrameMask],
    *,
    recorded: Sequence[BoolArray | None] = (),
    threads: int = 1,
) -> list[BoolArray] | None:
    """Of each view, the pixels (H, W) in and around what moves; None where light alone changes, or nothing does.

    ``current``, ``previous``: of every view its picture (3, H, W) 0..1 and its reference; ``recorded``: the pixels
    (H, W) of it that were, where that is not all. Raises ValueError when they are not the same views.
    """
    recorded = recorded or [None] * len(masks)
    with side_by_side(threads) as each:
        changes = list(each(lambda view: _changes(*view), zip(current, previous, masks, recorded, strict=True)))
    views = [pixels for pixels, _ in changes if pixels is not None]
    if not views:
        return None
    # All views together count as one more, since views may be unclear one by one.
    together = _Pixels(*(sum(getattr(view, each.name) for view in views) for each in fields(_Pixels)))
    if together.changed < _MIN_CHANGED_PIXELS or any(view.moves for view in (*views, together)):
        return [region for _, region in changes]
    return None


def _changes(
    current: FloatArray, previous: FloatArray, mask: FrameMask, recorded: BoolArray | None
) -> tuple[_Pixels | None, BoolArray]:
    """A view's changes, None without any, and the pixels (H, W) in and around what moves."""
    moving = np.zeros(mask.raw.shape, np.bool_)
    if not mask.dilated.any():
        return None, moving
    scale = min(1.0, math.sqrt(MAX_PIXELS / mask.raw.size))
    part = _bounds(mask)
    maps = change_maps(
        _small(previous[:, part[0], part[1]], scale),
        _small(current[:, part[0], part[1]], scale),
        picture_noise(previous[1], current[1], recorded=recorded),
    )
    around = maps.around(round(scale * mask.raw.shape[1]))
    moving[part] = _enlarge(around, moving[part].shape)
    return _Pixels(int(maps.changed.sum()), int(maps.restructured.sum()), int((maps.changed & around).sum())), moving


def _enlarge(region: BoolArray, shape: tuple[int, ...]) -> BoolArray:
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
