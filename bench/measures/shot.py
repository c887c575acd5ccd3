"""One frame as a held-out camera shows it beside what that recorded, and what a metric is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..estimates import NOTHING
from .metrics import BytePicture, Map, Mask, mean_over, psnr, square_error_map, ssim_map, total_variation
from .perceptual import Distance
from .regions import Regions


@dataclass(frozen=True, eq=False)
class Shot:
    """``before``, ``recorded_before``: as shown and recorded a frame earlier; None in the first. ``matte``: the
    subject's pixels, where the rig has one.

    ``distance``: LPIPS, where it is installed.
    """

    seen: BytePicture
    recorded: BytePicture
    before: BytePicture | None
    regions: Regions
    matte: Mask | None
    distance: Distance | None
    recorded_before: BytePicture | None = None

    @cached_property
    def errors(self) -> Map:
        """Squared error of every pixel and channel, (H, W, 3), of pictures in 0..1."""
        return square_error_map(self.seen, self.recorded)

    @cached_property
    def _likeness(self) -> Map:
        return ssim_map(self.seen, self.recorded)

    def psnr(self, mask: Mask | None = None) -> float | None:
        """dB over the pixels of ``mask``, or all; None where it holds none."""
        return psnr(self.errors, mask)

    def ssim(self, mask: Mask | None = None) -> float | None:
        """Its map's mean over the pixels of ``mask``, or all; None where it holds none."""
        return mean_over(self._likeness, mask)

    def psnr_of_change(self, mask: Mask) -> float | None:
        """dB, over the pixels of ``mask``, of what has changed since the frame before; None in the first."""
        if self.before is None or self.recorded_before is None:
            return None
        shown, recorded = (
            now.astype(np.float64) - before.astype(np.float64)
            for now, before in ((self.seen, self.before), (self.recorded, self.recorded_before))
        )
        return psnr(((shown - recorded) / 255) ** 2, mask)

    def change(self, mask: Mask) -> float | None:
        """Total variation since the frame before, in 0..1; None in the first."""
        return None if self.before is None else total_variation(self.before, self.seen, mask)


@dataclass(frozen=True)
class Metric:
    """A figure of a shot, and how tables have it: heading, meaning, digits, and as how many units one of it counts.

    ``column``: the column's key; None: the field's name. ``nothing``: what stands where there is no figure.
    """

    value: Callable[[Shot], float | None]
    heading: str
    meaning: str
    digits: int = 2
    units: int = 1
    column: str | None = None
    nothing: str = NOTHING
