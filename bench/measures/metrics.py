"""Picture quality over the whole image and over regions, flicker of static regions, and drift over time.

Chosen: every figure is of 8-bit pictures as ``decogs-decode`` writes them, against 8-bit pictures as recorded, so that
anyone can take it again from the decoded PNG files. Rejected: measuring the float rendering (a few thousandths of a dB
more, and nobody sees it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.encoder.backends.psnr import psnr_of

BytePicture = NDArray[np.uint8]
"""(H, W, 3) RGB, display-referred."""
Mask = NDArray[np.bool_]
"""(H, W)."""
Map = NDArray[np.float64]
"""One value per pixel and channel, (H, W, 3)."""

SSIM_WINDOW, SSIM_SIGMA = 11, 1.5
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2


@dataclass(frozen=True)
class Slope:
    """A straight line's slope and its standard error, both in units per 100 frames."""

    per_100_frames: float
    error: float


def square_error_map(seen: BytePicture | Map, recorded: BytePicture) -> Map:
    """Squared error of every pixel and channel, (H, W, 3), of pictures in 0..1."""
    return np.asarray(((seen.astype(np.float64) - recorded) / 255) ** 2)


def aligned(seen: BytePicture, recorded: BytePicture) -> Map:
    """``seen`` with its colours brought to those of ``recorded``, in 8-bit levels.

    Red, green and blue each by a quadratic curve of least squares: what camera and scene owe to exposure and white
    balance is no fault of the shape. Source: the colour-corrected PSNR of Barron 2022 (Mip-NeRF 360), its own channel
    only.
    """
    result = np.empty(seen.shape, np.float64)
    for channel in range(3):
        values = seen[..., channel].astype(np.float64).ravel() / 255
        terms = np.stack([np.ones_like(values), values, values**2], axis=1)
        curve, *_ = np.linalg.lstsq(terms, recorded[..., channel].astype(np.float64).ravel(), rcond=None)
        result[..., channel] = np.clip(terms @ curve, 0, 255).reshape(seen.shape[:2])
    return result


def psnr(square_errors: Map, mask: Mask | None = None) -> float | None:
    """PSNR in dB over all channels of the pixels in ``mask``; None when it holds no pixel. Equal pictures: 120 dB."""
    mean = mean_over(square_errors, mask)
    return None if mean is None else psnr_of(mean)


def ssim_map(seen: BytePicture, recorded: BytePicture) -> Map:
    """SSIM of every pixel and channel, (H, W, 3), of pictures in 0..1.

    Window: 11x11 Gaussian of sigma 1.5, zero outside the picture; C1 = 0.01^2, C2 = 0.03^2. Source: Wang 2004, with
    the border that 3DGS's code has.
    """
    a, b = seen.astype(np.float64) / 255, recorded.astype(np.float64) / 255
    mean_a, mean_b = _smooth(a), _smooth(b)
    variance_a, variance_b = _smooth(a * a) - mean_a**2, _smooth(b * b) - mean_b**2
    covariance = _smooth(a * b) - mean_a * mean_b
    likeness = (2 * mean_a * mean_b + SSIM_C1) * (2 * covariance + SSIM_C2)
    size = (mean_a**2 + mean_b**2 + SSIM_C1) * (variance_a + variance_b + SSIM_C2)
    return np.asarray(likeness / size, np.float64)


def mean_over(values: Map, mask: Mask | None = None) -> float | None:
    """Mean of a map (H, W, 3) over the pixels in ``mask`` and all channels; None when it holds no pixel."""
    chosen = values if mask is None else values[mask]
    return float(chosen.mean()) if chosen.size else None


def total_variation(before: BytePicture, after: BytePicture, static: Mask) -> float | None:
    """Mean change of the static pixels from one frame to the next, in 0..1; None when there are none.

    The mean over all pairs of frames, times 100, is mTV x100. Source: OR2 (Yun 2025), metrics_frames.py.
    """
    if not static.any():
        return None
    change = np.abs(after[static].astype(np.float64) - before[static]) / 255
    return float(change.mean())


def slope(frames: Sequence[int], values: Sequence[float]) -> Slope | None:
    """Least-squares slope of ``values`` over frame numbers, its error from the residuals; None below three frames."""
    if len(frames) < 3:
        return None
    x, y = np.asarray(frames, np.float64), np.asarray(values, np.float64)
    x = x - x.mean()
    spread = float(x @ x)
    steepness = float(x @ y) / spread
    residuals = y - y.mean() - steepness * x
    error = float(np.sqrt(residuals @ residuals / (len(x) - 2) / spread))
    return Slope(100 * steepness, 100 * error)


def _smooth(picture: Map) -> Map:
    window = cv2.getGaussianKernel(SSIM_WINDOW, SSIM_SIGMA, cv2.CV_64F)
    return np.asarray(cv2.sepFilter2D(picture, cv2.CV_64F, window, window, borderType=cv2.BORDER_CONSTANT))
