"""Views as the search for a stage sees them: not larger than it needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.splats import FloatArray

from ...input.ingest import View
from ...input.resizing import resized, resized_plane

BoolArray = NDArray[np.bool_]

_MAX_PIXELS = 250_000
"""Of a view; larger pictures are shrunk."""


@dataclass(frozen=True)
class StageView:
    """A pinhole ``camera``, its ``picture`` (H, W, 3) 0..1, and the pixels (H, W) that were recorded."""

    camera: Camera
    picture: FloatArray
    recorded: BoolArray


def stage_camera(view: View, most: int = _MAX_PIXELS) -> Camera:
    """The view's camera at the size of the search, of at most so many pixels."""
    return scale_camera(view.pinhole, min(1.0, (most / (view.pinhole.width * view.pinhole.height)) ** 0.5))


def stage_view(view: View, picture: FloatArray, most: int = _MAX_PIXELS) -> StageView:
    """The view with its ``picture`` (3, H, W), of at most so many pixels."""
    camera = stage_camera(view, most)
    planes = np.ascontiguousarray(resized(picture, camera).transpose(1, 2, 0))
    return StageView(camera, planes, recorded_pixels(view, camera))


def recorded_pixels(view: View, camera: Camera) -> BoolArray:
    """The pixels (H, W) of ``camera``, the view's at some size, that were recorded as a whole."""
    if view.valid is None:
        return np.ones((camera.height, camera.width), bool)
    return np.asarray(resized_plane(view.valid, camera) > 0.999)
