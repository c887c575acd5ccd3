"""Lamps that flicker over the rows of a camera's pictures: their phase and strength in a frame, and pictures without.

What lamps are like is known from the analysis of the rig, or from a keyframe that was given. A frame is compared with
the scene before it, which is in the lamps' mean light: the phase that explains the difference of odds best is measured
anew in every frame, so that drifting mains need no prediction.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import LAMP_STEP, Correction, LampWave, phase_steps, whole_steps
from decogs.decoder.cameras.corrections import apply_gain
from decogs.decoder.cameras.lamps import MOST_LAMP_LIGHT, lamp_light, lamp_waves
from decogs.formats.splats import FloatArray, logit
from decogs.rig.pictures.ingest import View

from .benefit import on_grid
from .colour import tukey_weights, unclipped

F64 = NDArray[np.float64]

_ROUNDS = 5
_GRID_PIXELS = 8000
"""Pixels that are compared: they give a phase to a fraction of a degree."""
_MIN_PIXELS = 500
"""Pixels that must be neither dark nor white, in all channels, to tell a phase."""


@dataclass(frozen=True)
class LampView:
    """A view whose pictures lamps change, and their ``wave``."""

    wave: LampWave
    view: View

    def find(self, recorded: FloatArray, rendered: FloatArray) -> Correction:
        """Phase and strength of the wave in a ``recorded`` picture (3, H, W) of what is ``rendered``; none if unknown.

        Gauss-Newton on the picture, robust to what moves; what a whole channel does is no lamp's.
        """
        shape = recorded.shape[1:]
        across, down = (on_grid(np.broadcast_to(share, shape), _GRID_PIXELS) for share in self.view.recorded_at)
        v, s = on_grid(recorded, _GRID_PIXELS), on_grid(rendered, _GRID_PIXELS)
        usable = np.asarray((unclipped(v) & unclipped(s)).all(axis=0))
        if self.view.valid is not None:
            usable &= on_grid(self.view.valid, _GRID_PIXELS) > 0
        if usable.sum() < _MIN_PIXELS:
            return Correction()
        v, s = (picture[:, usable].astype(np.float64) for picture in (v, s))
        first, second = (wave.T for wave in lamp_waves(self.wave, across[usable], down[usable]))
        turns, strength = _fitted(v, s, np.broadcast_to(first, v.shape), np.broadcast_to(second, v.shape))
        return Correction(lamp_phase=phase_steps(turns), lamp_amplitude=whole_steps(strength, LAMP_STEP))

    def undo(self, picture: FloatArray, correction: Correction) -> FloatArray:
        """The picture (3, H, W) in the lamps' mean light."""
        light = lamp_light(replace(correction, lamp=self.wave), *self.view.recorded_at)
        return np.ascontiguousarray(apply_gain(picture.transpose(1, 2, 0), 1 / light).transpose(2, 0, 1))


def _fitted(v: F64, s: F64, first: F64, second: F64) -> tuple[float, float]:
    """Turns and strength of the wave between ``first`` and ``second`` that takes colours ``s`` to ``v``, (3, N)."""
    difference, slope = logit(v) - logit(s), s * (1 - s)
    parts, offsets = np.zeros(2), np.median(difference, axis=1, keepdims=True)
    for _ in range(_ROUNDS):
        light = np.clip(1 + parts[0] * first + parts[1] * second, 1 / MOST_LAMP_LIGHT, MOST_LAMP_LIGHT)
        left = difference - np.log(light)
        weights = tukey_weights((slope * (left - offsets)).astype(np.float32)) * slope**2
        total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
        offsets = (weights * left).sum(axis=1, keepdims=True) / total
        slopes = np.stack([first / light, second / light])
        slopes = slopes - (weights * slopes).sum(axis=2, keepdims=True) / total  # without the channels' offsets
        normal = np.einsum("icn,cn,jcn->ij", slopes, weights, slopes)
        right = np.einsum("icn,cn->i", slopes, weights * (left - offsets))
        parts = parts + np.linalg.solve(normal + (1e-9 * np.trace(normal) + 1e-12) * np.eye(2), right)
    return float(np.arctan2(parts[1], parts[0]) / (2 * np.pi)), float(np.hypot(*parts))
