"""A keyframe's pictures as if each camera had taken all its rows at once, at the frame's instant.

Nothing is known yet of how the scene moves, so what moves is warped by the optical flow to the next frame: as far as it
moves until its row is read. Static pixels stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.rigs.timeline import RowTimes
from decogs.formats.splats import FloatArray
from decogs.rig.parallel import Each
from decogs.rig.pictures.ingest import RigFrame, View

_MIN_CHANGE = 6 / 255
"""Of a pixel's colour from frame to frame from which something moves there, above usual noise."""
_GROWN_PIXELS = 9
"""Pixels around what changes that are warped with it: objects are as changed at their edges as flat inside."""
_MAX_APART = 1.0
"""Pixels by which flow there and back may miss where it began; what it misses by more is covered or uncovered."""


def at_one_instant(
    frame: RigFrame, later: RigFrame, views: Sequence[View], times: Mapping[str, RowTimes], each: Each
) -> RigFrame:
    """The frame with what moves until the ``later`` one where it is at the frame's instant.

    ``times``: by camera, of those whose rows are of other times. A camera that lacks the later picture stays.
    """

    def warped(number: int) -> tuple[FloatArray, FloatArray | None]:
        view, picture = views[number], frame.training[number]
        alpha = frame.alpha[number] if frame.alpha else None
        own = times.get(view.camera.name)
        if own is None or view.camera.name in later.lost:
            return picture, alpha
        return _at_one_instant(picture, alpha, later.training[number], np.asarray(own.at(view.recorded_at.down)))

    made = list(each(warped, range(len(views))))
    pictures = [picture for picture, _ in made]
    alphas = [alpha for _, alpha in made if alpha is not None]
    return replace(frame, training=pictures, alpha=alphas if frame.alpha else frame.alpha)


def _at_one_instant(
    picture: FloatArray, alpha: FloatArray | None, later: FloatArray, late: NDArray[np.float64]
) -> tuple[FloatArray, FloatArray | None]:
    """A picture (3, H, W) and its alpha (H, W) whose pixels are recorded ``late`` frames after the frame's instant."""
    moving = np.abs(later - picture).max(axis=0) >= _MIN_CHANGE
    moving = cv2.morphologyEx(moving.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
    if not moving.any():
        return picture, alpha
    size = np.ones((_GROWN_PIXELS, _GROWN_PIXELS), np.uint8)
    near = cv2.blur(cv2.dilate(moving, size).astype(np.float32), (_GROWN_PIXELS // 2, _GROWN_PIXELS // 2))
    height, width = moving.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    flow = _sure_flow(picture, later, rows, columns)
    shift = flow * (near * np.broadcast_to(late, moving.shape))[..., None].astype(np.float32)
    across, down = columns + shift[..., 0], rows + shift[..., 1]

    def taken(plane: FloatArray) -> FloatArray:
        seen = cv2.remap(plane, across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.where(near > 0, np.clip(seen, 0, 1), plane).astype(np.float32)

    return np.stack([taken(plane) for plane in picture]), None if alpha is None else taken(alpha)


def _sure_flow(picture: FloatArray, later: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    """Pixels (H, W, 2) right and down that things move to the later picture; 0 where the way back is another."""
    before, after = (np.rint(255 * each.mean(axis=0)).astype(np.uint8) for each in (picture, later))
    method = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    none = np.zeros((*before.shape, 2), np.float32)
    there, back = method.calc(before, after, none), method.calc(after, before, none.copy())
    returned = cv2.remap(back, columns + there[..., 0], rows + there[..., 1], cv2.INTER_LINEAR)
    is_sure = np.hypot(*np.moveaxis(there + returned, -1, 0)) <= _MAX_APART
    return np.asarray(there * is_sure[..., None], np.float32)
