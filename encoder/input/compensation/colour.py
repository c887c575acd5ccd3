"""Exposure and white balance of a camera as shifts of its colours' logits against the scene's, per channel.

A gain on light before a display's curve, which nobody knows, is within 0.02 dB of a factor on the odds v / (1 - v) of
the coded value: black and white stay, nothing is clipped, and the inverse is the same with
1 / factor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import Correction
from decogs.decoder.cameras.corrections import apply_gain, as_recorded
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, logit
from decogs.rig.numerics import tukey

_DARKEST, _BRIGHTEST = 6 / 255, 249 / 255

_GRID_PIXELS = 40_000
"""A regular grid of about so many pixels suffices: the mean's own noise is then below 0.1 of an 8-bit level."""

_REWEIGHTINGS = 8
_TUKEY_DEVIATIONS = 4.685
"""Tukey's biweight at 95 % efficiency, in standard deviations."""

_MIN_RESIDUAL_SPREAD = 2 / 255
_MEDIAN_SAMPLES = 4000
"""Residuals whose median is taken, which gives it to two per cent."""


class LogitShift(NamedTuple):
    """Per channel, (3,) float64: the shift of the logit log(v / (1 - v)), and its precision (0: unknown)."""

    shift: NDArray[np.float64]
    precision: NDArray[np.float64]

    def without(self, shift: NDArray[np.float64]) -> LogitShift:
        """What is left when ``shift`` (3,) counts as none."""
        return self._replace(shift=self.shift - shift)


def logit_shift(recorded: FloatArray, rendered: FloatArray, valid: FloatArray | None = None) -> LogitShift:
    """How far the logits of ``recorded`` are from those of ``rendered``, both (3, H, W), robust to motion.

    ``valid`` (H, W) is 0 where nothing was recorded. Undetermined channels get 0.
    """
    step = max(1, round(np.sqrt(rendered[0].size / _GRID_PIXELS)))
    grid = np.s_[::step, ::step]
    mask = None if valid is None else valid[grid] > 0
    pairs = [_channel_shift(recorded[channel][grid], rendered[channel][grid], mask) for channel in range(len(rendered))]
    return LogitShift(np.array([shift for shift, _ in pairs]), np.array([precision for _, precision in pairs]))


def unclipped(values: FloatArray) -> NDArray[np.bool_]:
    """Where colour values are neither clipped nor next to noise."""
    return np.asarray((values > _DARKEST) & (values < _BRIGHTEST))


def tukey_weights(residuals: FloatArray) -> FloatArray:
    """Tukey's biweight of residuals in picture units, by their own spread: 1 for none, 0 for what does not belong."""
    some = residuals.ravel()[:: max(1, residuals.size // _MEDIAN_SAMPLES)]
    spread = max(1.4826 * float(np.median(np.abs(some))), _MIN_RESIDUAL_SPREAD)
    return tukey(residuals, _TUKEY_DEVIATIONS * spread)


def remove_gain(picture: FloatArray, odds_gain: tuple[float, float, float]) -> FloatArray:
    """A recorded picture (3, H, W) in the scene's own colours."""
    red, green, blue = odds_gain
    planes = apply_gain(picture.transpose(1, 2, 0), (1 / red, 1 / green, 1 / blue))
    return np.ascontiguousarray(planes.transpose(2, 0, 1))


def remove_colours(picture: FloatArray, correction: Correction, camera: Camera) -> FloatArray:
    """A picture (3, H, W) that the camera recorded in the scene's own colours, as bright at its border."""
    planes = as_recorded(picture.transpose(1, 2, 0), correction, camera, undo=True)
    return np.ascontiguousarray(planes.transpose(2, 0, 1))


def _channel_shift(recorded: FloatArray, rendered: FloatArray, mask: NDArray[np.bool_] | None) -> tuple[float, float]:
    """Gauss-Newton on the corrected picture; weighed by the scene's value, so that recorded noise has no bias."""
    inside = unclipped(recorded) & unclipped(rendered)
    if mask is not None:
        inside &= mask
    if not inside.any():
        return 0.0, 0.0
    v, s = recorded[inside], rendered[inside]
    slope = s * (1 - s)
    shift = float(np.median(logit(v) - logit(s)))
    precision = 0.0
    for _ in range(_REWEIGHTINGS):
        factor = np.float32(np.exp(-shift))
        corrected = factor * v / (1 + (factor - 1) * v)
        weights = tukey_weights(corrected - s) * slope
        precision = float((weights * corrected * (1 - corrected)).sum(dtype=np.float64))
        if not precision:
            break
        step = float((weights * (corrected - s)).sum(dtype=np.float64)) / precision
        shift += step
        if abs(step) < 1e-5:
            break
    return shift, precision
