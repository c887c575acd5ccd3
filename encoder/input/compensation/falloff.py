"""Lens fall-off: how much darker each camera's picture is towards its border, found at the keyframe's first points.

Lenses darken their borders, each its own, and a scene of Gaussians can show that only by haze before the cameras. A
point in the middle of one picture and at the border of another tells the two apart from its own colour: all cameras'
gains and fall-offs under which the points' colours agree best are solved for together, robustly, with each point's own
colour eliminated. Fall-off is that of light over 1 + k t^2, squared, where t is the tangent of the angle to the
camera's axis; k = 1 is the law of the fourth power of the cosine.

How sure it is comes from a jackknife over blocks of space (Efron, 1982), since points that are wrong, or shine, are so
in groups, and from fall-offs below 0, which no lens has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import FALLOFF_STEP, LARGEST, Correction, Corrections
from decogs.formats.cameras import Camera, project, ray_slopes
from decogs.formats.splats import FloatArray, logit
from decogs.rig.pictures.ingest import View

from .colour import tukey_weights, unclipped
from .matching import colours_at

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

MIN_LOSS = 0.06
"""Share of the light lost in a picture's corner from which a fall-off counts: 2 levels at mid-grey."""
MIN_DEVIATIONS = 5.0
"""Of a fall-off from none, in standard deviations, from which it is sure."""
_MIN_POINT_VIEWS = 3
_MOST_POINTS = 8000
_MIN_VIEW_POINTS = 100
"""Points below which a view's fall-off is unknown."""
_MIN_PIXELS = 16_000
"""Of a picture, below which it tells no fall-off: a point's colour, a mean of nine pixels, is then also that of things
beside it (88 x 66: 12 % of the light, at ten deviations, where there is none)."""
_BLOCKS_LOG2 = 4
_ROUNDS = 8
_CHANNELS = 3
_MOST_BRIGHTER, _LARGEST_K = 0.5, 5.0
"""Bounds of k: as much below 0 as leaves half of 1 + k t^2 in a corner, for estimates of none scatter; and above."""
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
    enough = np.flatnonzero(seen.sum(axis=0) >= _MIN_POINT_VIEWS)
    if len(enough) > _MOST_POINTS:
        enough = np.sort(np.random.default_rng(0).choice(enough, _MOST_POINTS, replace=False))
    points, seen = xyz[enough].astype(np.float64), seen[:, enough]
    values = np.stack([colours_at(view, picture, points) for view, picture in zip(views, pictures, strict=True)])
    tangents = np.stack([_squared_tangents(view.pinhole, points) for view in views])
    corner = np.array([_squared_corner(view.pinhole) for view in views])
    fit = _Fit(values, np.where(seen, tangents, 0.0), seen, least=-_MOST_BRIGHTER / corner)
    k, deviation = fit.solve(_blocks(points))
    is_large = np.array([view.pixels >= _MIN_PIXELS for view in views])
    return Falloff(np.where(is_large, k, 0), np.where(is_large, deviation, np.inf), corner)


def falloff_corrections(views: Sequence[View], found: Falloff) -> Corrections:
    """The corrections of cameras with a likely fall-off, by camera; none unless one surely has it."""
    if not found.is_sure.any():
        return {}
    steps = np.minimum(np.rint(found.likely() / FALLOFF_STEP), LARGEST).astype(int).tolist()
    return {view.camera.name: Correction(falloff=step) for view, step in zip(views, steps, strict=True) if step}


class _Fit:
    """Gains and fall-offs of views (V,) from logits of points' colours, by reweighted Gauss-Newton.

    Unknowns of a view: its gain in each channel, and k. A common gain fits as well; that with mean 0 is taken.
    """

    def __init__(self, values: FloatArray, tangents: F64, seen: BoolArray, least: F64) -> None:
        self._tangents, self._least = tangents, least
        usable = [seen & unclipped(values[..., channel]) for channel in range(_CHANNELS)]
        self._usable = [each & (each.sum(axis=0) > 1) for each in usable]
        inside = [np.where(use, values[..., c], np.float32(0.5)) for c, use in enumerate(self._usable)]
        self._logs = [logit(each).astype(np.float64) for each in inside]
        self._slopes = [
            np.where(use, s * (1 - s), 0).astype(np.float64) for s, use in zip(inside, self._usable, strict=True)
        ]
        self._weights = [slope**2 for slope in self._slopes]
        views = len(values)
        self._gains, self._k = np.zeros((_CHANNELS, views)), np.zeros(views)
        self._known = np.min([use.sum(axis=1) for use in self._usable], axis=0) >= _MIN_VIEW_POINTS

    def solve(self, blocks: Sequence[NDArray[np.int64]]) -> tuple[F64, F64]:
        """k (V,) and its deviation, by leaving out one of the ``blocks`` of points after the other."""
        views = len(self._k)
        if not self._known.any():
            return self._k, np.full(views, np.inf)
        for _ in range(_ROUNDS):
            normal, right = self._equations(np.arange(self._logs[0].shape[1]))
            self._step(_solved(normal, right))
            self._reweigh()
        parts = [self._equations(block) for block in blocks]
        normal, right = (np.sum([part[which] for part in parts], axis=0) for which in range(2))
        without = np.array([_solved(normal - part, right - rest)[-views:] for part, rest in parts])
        count = len(blocks)
        variance = (count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
        # No lens brightens its border: fall-offs below 0 tell how wrong all of them may be.
        variance += 2 * (np.minimum(self._k[self._known], 0) ** 2).mean()
        return np.where(self._known, self._k, 0), np.where(self._known, np.sqrt(variance), np.inf)

    def _equations(self, points: NDArray[np.int64]) -> tuple[F64, F64]:
        """Normal equations of some points, unknowns by channel, then k."""
        views = len(self._k)
        normal, right = np.zeros((4, 4, views, views)), np.zeros((4, views))
        tangents = self._tangents[:, points]
        darker = -2 * tangents / (1 + self._k[:, None] * tangents)
        for channel in range(_CHANNELS):
            weights = self._weights[channel][:, points]
            total = np.maximum(weights.sum(axis=0), 1e-12)
            error = self._errors(channel, points)
            for one, first in ((channel, weights), (3, weights * darker)):
                right[one] += (first * error).sum(axis=1)
                for other, second in ((channel, np.ones_like(darker)), (3, darker)):
                    eliminated = np.einsum("vp,wp->vw", first / total, weights * second)
                    normal[one, other] += np.diag((first * second).sum(axis=1)) - eliminated
        for channel in range(_CHANNELS):  # the mean gain
            normal[channel, channel] += max(float(np.trace(normal[channel, channel])) / views**2, 1e-9)
        size = 4 * views
        return normal.transpose(0, 2, 1, 3).reshape(size, size), right.ravel()

    def _errors(self, channel: int, points: NDArray[np.int64]) -> F64:
        """Logits (V, P) of some points less their own and what the views make of them."""
        darkening = -2 * np.log1p(self._k[:, None] * self._tangents[:, points])
        left = self._logs[channel][:, points] - self._gains[channel][:, None] - darkening
        weights = self._weights[channel][:, points]
        return np.asarray(left - (weights * left).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-12))

    def _step(self, step: F64) -> None:
        each = step.reshape(4, -1)
        self._gains = self._gains + each[:_CHANNELS]
        self._k = np.clip(self._k + each[3], self._least, _LARGEST_K)

    def _reweigh(self) -> None:
        every = np.arange(self._logs[0].shape[1])
        for channel, (slope, use) in enumerate(zip(self._slopes, self._usable, strict=True)):
            weights = slope**2
            errors = (slope * self._errors(channel, every))[use].astype(np.float32)
            weights[use] *= tukey_weights(errors)
            self._weights[channel] = weights


def _solved(normal: F64, right: F64) -> F64:
    scale = max(float(np.trace(normal)) / len(right), 1e-9)
    return np.asarray(np.linalg.solve(normal + 1e-7 * scale * np.eye(len(right)), right))


def _squared_tangents(camera: Camera, points: F64) -> F64:
    """Squared tangents (P,) of the angles between the camera's axis and the points."""
    column, row, _ = project(camera, points)
    # A point that the view does not see may project anywhere, at infinity too.
    x, y = ray_slopes(camera, *(np.clip(np.nan_to_num(at), -1e6, 1e6) for at in (column, row)))
    return np.asarray(x**2 + y**2, np.float64)


def _squared_corner(camera: Camera) -> float:
    x, y = ray_slopes(camera, np.array([0.0, camera.width]), np.array([0.0, camera.height]))
    return float((x**2).max() + (y**2).max())


def _blocks(points: F64) -> list[NDArray[np.int64]]:
    """The points' numbers in blocks of space with as many in each: halved along their longest side, again and again."""
    blocks = [np.arange(len(points))]
    for _ in range(_BLOCKS_LOG2):
        blocks = [half for block in blocks for half in _halves(points, block)]
    return blocks


def _halves(points: F64, block: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    if not len(block):
        return block, block
    axis = int(np.ptp(points[block], axis=0).argmax())
    order = block[np.argsort(points[block, axis], kind="stable")]
    return order[: len(order) // 2], order[len(order) // 2 :]
