"""Views as the search for a stage sees them: not larger than it needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from decogs.decoder.cameras.resizing import recorded_pixels, resized
from decogs.decoder.subject.hull import MOST_PIXELS, BoolArray, hull_camera
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray

from ..pictures.ingest import View


@dataclass(frozen=True)
class StageView:
    """A pinhole ``camera``, its ``picture`` (H, W, 3) 0..1, and the pixels (H, W) that were recorded."""

    camera: Camera
    picture: FloatArray
    recorded: BoolArray

    def share(self, pixels: BoolArray) -> float:
        """Of the recorded pixels that are among ``pixels`` (H, W)."""
        return float(pixels[self.recorded].mean()) if self.recorded.any() else 0.0


def stage_view(view: View, picture: FloatArray, most: int = MOST_PIXELS) -> StageView:
    """The view with its ``picture`` (3, H, W), of at most so many pixels."""
    camera = hull_camera(view.pinhole, most)
    planes = np.ascontiguousarray(resized(picture, camera).transpose(1, 2, 0))
    return StageView(camera, planes, recorded_pixels(view.valid, camera))
