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
from decogs.rig.pictures.optical_flow import MAX_APART_PIXELS, flow_and_back

_MIN_CHANGE = 6 / 255
"""Of a pixel's colour from frame to frame from which something moves there, above usual noise."""
_GROWN_PIXELS = 9
"""Pixels around what changes that are warped with it: objects are as changed at their edges as flat inside."""


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
    there, back = flow_and_back(picture.mean(axis=0), later.mean(axis=0), smooth=True)
    returned = cv2.remap(back, columns + there[..., 0], rows + there[..., 1], cv2.INTER_LINEAR)
    is_sure = np.hypot(*np.moveaxis(there + returned, -1, 0)) <= MAX_APART_PIXELS
    shift = there * (is_sure * near * np.broadcast_to(late, moving.shape))[..., None].astype(np.float32)
    across, down = columns + shift[..., 0], rows + shift[..., 1]

    def taken(plane: FloatArray) -> FloatArray:
        seen = cv2.remap(plane, across, down, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.where(near > 0, np.clip(seen, 0, 1), plane).astype(np.float32)

    return np.stack([taken(plane) for plane in picture]), None if alpha is None else taken(alpha)
