"""Plain regions of pictures, the pictures without what stands in front of them, and what does.

A plain region has no texture above the picture's noise: a wall, a floor or a cloth of any one colour, lit unevenly or
not, or one out of focus. No colour is assumed.
"""

from __future__ import annotations

import cv2
import numpy as np

from decogs.decoder.subject.hull import BoolArray
from decogs.formats.splats import FloatArray

from ..mattes.filling import push_pull
from ..numerics import floats

_WINDOW_PIXELS = 5
"""Side of the window whose deviation from its own plane of colours is noise or texture."""
_NOISE_PERCENTILE = 25.0
"""Of the windows' deviations: noise, where that many windows are plain."""
_MIN_NOISE_LEVELS, _MAX_NOISE_LEVELS = 0.5, 4.0
"""Bounds of the noise: rounding to 8 bits; and more is texture in every window."""
_MAX_NOISE_RATIO = 1.8
"""Largest deviation of a plain window, in units of the noise."""
_MIN_REGION_SHARE = 0.04
"""Least share of the picture of a plain region: smaller ones are parts of things."""
_SUBJECT_LEVELS = 12.0
"""Difference from the plate from which a pixel shows a subject for sure, at least."""
_FAINT_SUBJECT_SHARE = 0.5
"""Of that difference, from which a pixel beside such a one does."""
_MIN_SUBJECT_SHARE = 2e-4
"""Least share of the picture of a subject."""


def plain_pixels(picture: FloatArray) -> BoolArray:
    """Pixels (H, W) of large regions without texture; ``picture`` (H, W, 3) RGB 0..1."""
    opened = smooth_pixels(picture).view(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_REGION_SHARE * opened.size
    large[0] = False
    return np.asarray(large[labels])


def smooth_pixels(picture: FloatArray) -> BoolArray:
    """Pixels (H, W) without texture above the picture's noise; ``picture`` (H, W, 3) RGB 0..1."""
    deviation, noise = _deviation(picture)
    smooth = (deviation <= _MAX_NOISE_RATIO * noise).astype(np.uint8)
    return cv2.morphologyEx(smooth, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).view(np.bool_)


def _deviation(picture: FloatArray) -> tuple[FloatArray, float]:
    """Deviation of every window from its smooth part, (H, W), of the colour with most; and the noise; 8-bit levels."""
    window = (_WINDOW_PIXELS, _WINDOW_PIXELS)
    detail = picture - floats(cv2.GaussianBlur(picture, (0, 0), _WINDOW_PIXELS / 2))
    variance = np.maximum(floats(cv2.blur(detail * detail, window)), 0.0)  # its running sums go below 0 by rounding
    deviation = 255 * np.sqrt(variance.max(axis=2))
    return deviation, float(np.clip(np.percentile(deviation, _NOISE_PERCENTILE), _MIN_NOISE_LEVELS, _MAX_NOISE_LEVELS))


def plate_of(picture: FloatArray, plain: BoolArray) -> FloatArray:
    """The picture (H, W, 3) with its plain regions going on behind everything else."""
    weights = floats(cv2.erode(plain.astype(np.float32), np.ones((_WINDOW_PIXELS,) * 2, np.uint8)))
    smooth = floats(cv2.blur(picture * weights[..., None], (3, 3)))
    weight = floats(cv2.blur(weights, (3, 3)))
    values = np.divide(smooth, weight[..., None], out=np.zeros_like(picture), where=weight[..., None] > 0)
    return push_pull(values, weights)


def subject_pixels(picture: FloatArray, plate: FloatArray) -> BoolArray:
    """Pixels (H, W) that differ from the plate: what stands in front of it, with its shadows."""
    _, noise = _deviation(picture)
    surely = max(_SUBJECT_LEVELS, 5 * noise)
    difference = 255 * floats(cv2.blur(np.abs(picture - plate), (3, 3))).max(axis=2)
    faint = (difference > _FAINT_SUBJECT_SHARE * surely).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(faint, connectivity=8)
    sure = np.bincount(labels[difference > surely], minlength=count) > 0
    sure &= stats[:, cv2.CC_STAT_AREA] >= _MIN_SUBJECT_SHARE * faint.size
    sure[0] = False
    return np.asarray(sure[labels])
