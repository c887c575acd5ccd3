"""Where the pixels of a camera's training pictures were recorded, through its lens."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import distort_pixels
from decogs.formats.cameras import Camera, as_pinhole, is_distorted, ray_slopes
from decogs.formats.splats import FloatArray


class RecordedAt(NamedTuple):
    """Shares of the recorded picture's width and height, float32, (H, W) or broadcast to it."""

    across: FloatArray
    down: FloatArray


def recorded_at(camera: Camera, pinhole: Camera) -> RecordedAt:
    """Of every pixel of the ``pinhole``, through which the ``camera``'s pictures are trained on."""
    columns, rows = np.arange(pinhole.width)[None] + 0.5, np.arange(pinhole.height)[:, None] + 0.5
    if not is_distorted(camera):
        return RecordedAt(_rounded(columns / pinhole.width), _rounded(rows / pinhole.height))
    x, y = ray_slopes(pinhole, *np.broadcast_arrays(columns, rows))
    straight = as_pinhole(camera)
    pixels = np.stack([x * straight.fx + straight.cx, y * straight.fy + straight.cy], axis=-1)
    u, v = np.moveaxis(np.nan_to_num(distort_pixels(camera, pixels)), -1, 0)
    return RecordedAt(_rounded(np.clip(u / camera.width, 0, 1)), _rounded(np.clip(v / camera.height, 0, 1)))


def _rounded(share: NDArray[np.float64]) -> FloatArray:
    return share.astype(np.float32)
