"""Lens fall-off: how much darker each camera's picture is towards its border, found at the keyframe's first points.

Lenses darken their borders, each its own, and a scene of Gaussians can show that only by haze before the cameras.
Fall-off is that of light over 1 + k t^2, squared, where t is the tangent of the angle to the camera's axis; k = 1 is
the law of the fourth power of the cosine. It is fitted together with the cameras' gains (`point_fit.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import FALLOFF_STEP, LARGEST, Correction, Corrections
from decogs.formats.splats import FloatArray
from decogs.rig.pictures.ingest import View

from .point_fit import PointFit, SharedPoints, shared_points

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MIN_LOSS = 0.06
"""Share of the light lost in a picture's corner from which a fall-off counts: 2 levels at mid-grey."""
MIN_DEVIATIONS = 5.0
"""Of a fall-off from none, in standard deviations, from which it is sure."""
_MIN_SPREAD = 0.02
"""Least deviation of fall-offs between cameras, as k: that of copies of one lens."""


@dataclass(frozen=True)
class Falloff:
    """Each camera's fall-off: ``k`` (V,), its standard ``deviation`` (V,), infinite where unknown; ``corner`` (V,): the
    largest squared tangent in its picture."""

    k: F64
    deviation: F64
    corner: F64

    @property
    def losses(self) -> F64:
        """Share of the light (V,) that is lost in a corner; below 0 where it is brighter."""
        return np.asarray(1 - (1 + self.k * self.corner) ** -2)

    @property
    def is_sure(self) -> BoolArray:
        """Cameras (V,) that surely have one."""
        return np.asarray((self.losses >= MIN_LOSS) & (self.k >= MIN_DEVIATIONS * self.deviation))

    def likely(self) -> F64:
        """The most likely k (V,), 0 or above: unsure ones lean towards the cameras' mean, by their spread."""
        known = np.isfinite(self.deviation)
        weights = np.where(known, 1 / (self.deviation**2 + _MIN_SPREAD**2), 0.0)
        if not weights.any():
            return np.zeros_like(self.k)
        mean = float((weights * self.k).sum() / weights.sum())
        excess = (self.k - mean) ** 2 - self.deviation**2
        spread = max(float((weights * np.where(known, excess, 0)).sum() / weights.sum()), _MIN_SPREAD**2)
        own = np.where(known, spread / (spread + np.where(known, self.deviation, 0) ** 2), 0.0)
        return np.asarray(np.maximum(mean + own * (self.k - mean), 0))


def find_falloff(views: Sequence[View], pictures: Sequence[FloatArray], xyz: FloatArray, seen: BoolArray) -> Falloff:
    """How every view's picture darkens to its border.

    ``pictures``: (3, H, W) of every view. ``xyz`` (P, 3): points of the surface, which the views see where ``seen``
    (V, P).
    """
    points = shared_points(views, pictures, xyz, seen)
    fit = PointFit(points)
    fit.fit()
    return falloff_of(fit, points)


def falloff_of(fit: PointFit, points: SharedPoints) -> Falloff:
    """What a ``fit`` tells of fall-off."""
    if not fit.is_known.any():
        return Falloff(fit.k, np.full(len(fit.k), np.inf), points.corner)
    known, variance = fit.is_known, fit.deviations()[0] ** 2
    # No lens brightens its border: fall-offs below 0 tell how wrong all of them may be.
    variance = variance + 2 * (np.minimum(fit.k[known], 0) ** 2).mean()
    return Falloff(np.where(known, fit.k, 0), np.where(known, np.sqrt(variance), np.inf), points.corner)


def falloff_corrections(views: Sequence[View], found: Falloff) -> Corrections:
    """The corrections of cameras with a likely fall-off, by camera; none unless one surely has it."""
    if not found.is_sure.any():
        return {}
    steps = np.minimum(np.rint(found.likely() / FALLOFF_STEP), LARGEST).astype(int).tolist()
    return {view.camera.name: Correction(falloff=step) for view, step in zip(views, steps, strict=True) if step}
