"""What the keyframe's training does otherwise where pictures are large, and a Gaussian has to show many pixels.

Coarse to fine: the first steps see shrunk pictures, the last ones the pictures as they are. A step's cost grows with
the pixels, and what the first steps do, moving, growing and colouring Gaussians that are far off, shows in shrunk
pictures as well. The renderer's filter belongs to the pixel (Mip-Splatting, Yu 2024), so that a scene from shrunk
pictures fits larger ones. Gaussians are more pixels from each other in such pictures, so they take longer steps, and
fewer. Fewer first points leave room for those that densification puts where details are. Smaller pictures keep the
settings' schedule. Figures: DESIGN.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from decogs.decoder.cameras.resizing import resized_plane
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.splats import FloatArray

from ..settings.keyframe import KeyframeSettings

LARGE_PICTURE_PIXELS = 240_000
"""Pixels from which pictures are large: 566x424. The rigs that presets were tuned on have fewer."""
_MIN_SHRUNK_PIXELS = LARGE_PICTURE_PIXELS // 4
"""Pixels that a shrunk picture has at least."""
_FULL_SIZE_BEGIN = 0.7
"""Share of the schedule after which pictures have their own size."""
_FULL_SIZE_RATE_PROGRESS = 0.2
"""How far step sizes have fallen by then, as a share of their schedule: the last scale has most of their fall."""
_ITERATIONS_FACTOR = 0.75
"""Of the settings' iterations."""
_MIN_FIRST_POINTS_SHARE = 0.5
"""Least share of the Gaussians that begin as first points."""


@dataclass(frozen=True)
class PictureScale:
    """Steps from ``begin`` on see pictures shrunk by ``factor``, a power of two; 1 is the pictures themselves."""

    begin: int
    factor: int


@dataclass(frozen=True)
class PictureFit:
    """A schedule of ``iterations`` for pictures of one size.

    ``scales``: in order, the first from step 0, the last with factor 1. ``first_points``: at most. ``longer``: factor
    of the positions' step size.
    """

    iterations: int
    scales: tuple[PictureScale, ...]
    first_points: int
    longer: float

    def rate_progress(self, progress: float) -> float:
        """Where the fall of the step sizes is at ``progress`` of the schedule, both 0 to 1."""
        if len(self.scales) == 1:
            return progress
        if progress < _FULL_SIZE_BEGIN:
            return progress * _FULL_SIZE_RATE_PROGRESS / _FULL_SIZE_BEGIN
        return _FULL_SIZE_RATE_PROGRESS + (1 - _FULL_SIZE_RATE_PROGRESS) * (progress - _FULL_SIZE_BEGIN) / (
            1 - _FULL_SIZE_BEGIN
        )


def unscaled_schedule(settings: KeyframeSettings) -> PictureFit:
    """The schedule of pictures of any size as if they were small."""
    return PictureFit(settings.iterations, (PictureScale(0, 1),), settings.seen_cap, 1.0)


def fit_to_pictures(recorded: Sequence[int], settings: KeyframeSettings) -> PictureFit:
    """The schedule for pictures of which so many pixels were ``recorded``: by the mean."""
    pixels = float(np.mean(recorded))
    if pixels < LARGE_PICTURE_PIXELS:
        return unscaled_schedule(settings)
    factors = [1]
    while pixels >= _MIN_SHRUNK_PIXELS * (2 * factors[0]) ** 2:
        factors.insert(0, 2 * factors[0])
    iterations = max(1, round(_ITERATIONS_FACTOR * settings.iterations))
    each = _FULL_SIZE_BEGIN * iterations / (len(factors) - 1)
    scales = tuple(PictureScale(round(number * each), factor) for number, factor in enumerate(factors))
    longer = (pixels / LARGE_PICTURE_PIXELS) ** 0.5
    return PictureFit(iterations, scales, round(settings.seen_cap * max(_MIN_FIRST_POINTS_SHARE, 1 / longer)), longer)


def shrunk_camera(camera: Camera, factor: int) -> Camera:
    """The camera that takes pictures shrunk by ``factor``."""
    return camera if factor == 1 else scale_camera(camera, 1 / factor)


def shrunk_weights(counted: FloatArray | None, camera: Camera) -> FloatArray | None:
    """Pixels that count (H, W), at the size of ``camera``: those that cover none that does not."""
    if counted is None or counted.shape == (camera.height, camera.width):
        return counted
    return np.ascontiguousarray(resized_plane(counted, camera) > 0.999, np.float32)
