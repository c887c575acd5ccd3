"""A subject before a backdrop that a clean picture of the same camera shows.

A soft shadow darkens the backdrop and leaves its colour: only what no shadow explains is surely subject; with
hysteresis what differs less around it. The noise is measured between picture and plate; the exposure may have moved.
"""

from __future__ import annotations

import cv2
import numpy as np

from decogs.formats.splats import FloatArray

from .cutting import BoolArray, Subject, cut_out

_MIN_NOISE_LEVELS, _MAX_NOISE_LEVELS = 0.5, 12.0
"""Deviation that rounding to 8 bits makes; and one from which a plate shows something else than the picture."""
_SURE_NOISES, _FAINT_NOISES = 5.0, 3.0
"""Difference from the plate of what is surely subject, and of what may be beside it, in units of the noise."""
_SHADOW = (0.35, 1.1)
"""Light that is left in a shadow, and that bounces, relative to the plate's: linear."""
_MAX_GAIN = 0.25
"""Largest change of exposure between plate and picture, of its logarithm."""
_SMOOTHING_PIXELS = 0.8
_MIN_SUBJECT_SHARE, _MAX_HOLE_SHARE = 2e-4, 0.02
"""Least share of the picture of a subject, and largest of a hole in one that is looked at."""


def before_plate(picture: FloatArray, plate: FloatArray) -> Subject | None:
    """The subject in a picture (H, W, 3) of which ``plate`` shows the backdrop alone; both in linear light.

    None where most of the picture differs from the plate.
    """
    seen, behind = _smooth(picture), _smooth(plate)
    gain = _gain(seen, behind)
    behind, lit = behind * np.float32(gain), plate * np.float32(gain)
    shade = np.clip((seen * behind).sum(axis=2) / np.maximum((behind * behind).sum(axis=2), 1e-8), *_SHADOW)[..., None]
    differs, unexplained = _levels_apart(seen, behind), _levels_apart(seen, behind * shade)
    noise = max(float(np.median(differs)), _MIN_NOISE_LEVELS)
    if noise > _MAX_NOISE_LEVELS:
        return None
    subject = _hysteresis(unexplained > _FAINT_NOISES * noise, unexplained > _SURE_NOISES * noise)
    subject |= _dark_holes(subject, differs > _FAINT_NOISES * noise)
    return cut_out(picture, np.where(subject[..., None], lit, lit * shade).astype(np.float32), ~subject)


def _smooth(picture: FloatArray) -> FloatArray:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), _SMOOTHING_PIXELS), np.float32)


def _gain(picture: FloatArray, plate: FloatArray) -> float:
    """How much brighter the picture is where it shows the plate, by the median pixel."""
    ratio = np.log(np.maximum(picture.mean(axis=2), 1e-4) / np.maximum(plate.mean(axis=2), 1e-4))
    return float(np.exp(np.clip(np.median(ratio), -_MAX_GAIN, _MAX_GAIN)))


def _levels_apart(one: FloatArray, other: FloatArray) -> FloatArray:
    """Difference (H, W) of linear colours, about as 8-bit pictures show it, of the colour with most."""
    return np.asarray(255 * np.abs(np.sqrt(np.clip(one, 0, 1)) - np.sqrt(np.clip(other, 0, 1))).max(axis=2), np.float32)


def _hysteresis(faint: BoolArray, sure: BoolArray) -> BoolArray:
    """Regions of ``faint`` pixels that hold a ``sure`` one and are no speck."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(faint.astype(np.uint8), connectivity=8)
    held = np.bincount(labels[sure], minlength=count) > 0
    held &= stats[:, cv2.CC_STAT_AREA] >= _MIN_SUBJECT_SHARE * faint.size
    held[0] = False
    return np.asarray(held[labels])


def _dark_holes(subject: BoolArray, differs: BoolArray) -> BoolArray:
    """Holes in a subject that do not show the plate as it is: cloth that a shadow would explain."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~subject).astype(np.uint8), connectivity=4)
    filled = np.zeros(len(stats), np.bool_)
    for label in range(1, len(stats)):
        x, y, w, h, area = stats[label]
        if area < _MAX_HOLE_SHARE * subject.size:
            box = slice(y, y + h), slice(x, x + w)
            amid = x > 0 and y > 0 and x + w < subject.shape[1] and y + h < subject.shape[0]
            filled[label] = amid and differs[box][labels[box] == label].mean() > 0.5
    return np.asarray(filled[labels])
