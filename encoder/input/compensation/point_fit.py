"""What cameras do to the colours of points that they share: gains, fall-offs, and waves of lamps over the rows.

A point in the middle of one picture and at the border of another tells the cameras' doing from its own colour. All
cameras' parameters under which the points' colours agree best are solved for together, robustly (Gauss-Newton on
logits, reweighted), with each point's own colour eliminated. How sure they are comes from a jackknife over blocks of
space (Efron, 1982), since points that are wrong, or shine, are so in groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, in_picture, project, ray_slopes
from decogs.formats.splats import FloatArray, logit
from decogs.rig.pictures.ingest import View

from .colour import tukey_weights, unclipped
from .matching import colours_at

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_MIN_POINT_VIEWS = 3
_MOST_POINTS = 8000
_MIN_VIEW_POINTS = 100
"""Points below which a view's parameters are unknown."""
_MIN_PIXELS = 16_000
"""Of a picture, below which it tells nothing: a point's colour, a mean of nine pixels, is then also that of things
beside it (88 x 66: a fall-off of 12 % of the light, at ten deviations, where there is none)."""
_BLOCKS_LOG2 = 4
_ROUNDS = 8
_CHANNELS = 3
_MOST_BRIGHTER, _LARGEST_K = 0.5, 5.0
"""Bounds of k: as much below 0 as leaves half of 1 + k t^2 in a corner, for estimates of none scatter; and above."""
_WAVE_PRIOR = 0.02
"""Weight of no wave, by that of a view's points: what all views share of one looks like the points' own colours."""
_DARKEST_WAVE = 0.2


@dataclass(frozen=True)
class SharedPoints:
    """Points (P,) of the surface as views (V,) see them where ``seen`` (V, P).

    ``values`` (V, P, 3): their colours. ``tangents`` (V, P): squared, of the angles to the cameras' axes; ``corner``
    (V,): the largest in each picture. ``down`` (V, P): share of the recorded picture's height. ``blocks``: of points
    that are near each other. ``is_large`` (V,): views whose pictures tell something.
    """

    values: FloatArray
    seen: BoolArray
    tangents: F64
    corner: F64
    down: F64
    blocks: Sequence[NDArray[np.int64]]
    is_large: BoolArray


def shared_points(
    views: Sequence[View], pictures: Sequence[FloatArray], xyz: FloatArray, seen: BoolArray
) -> SharedPoints:
    """Those of the points ``xyz`` (P, 3), which views see where ``seen`` (V, P), that three see, as far as needed.

    ``pictures``: (3, H, W) of every view.
    """
    enough = np.flatnonzero(seen.sum(axis=0) >= _MIN_POINT_VIEWS)
    if len(enough) > _MOST_POINTS:
        enough = np.sort(np.random.default_rng(0).choice(enough, _MOST_POINTS, replace=False))
    points, seen = xyz[enough].astype(np.float64), seen[:, enough]
    tangents = np.stack([_squared_tangents(view.pinhole, points) for view in views])
    return SharedPoints(
        np.stack([colours_at(view, picture, points) for view, picture in zip(views, pictures, strict=True)]),
        seen,
        np.where(seen, tangents, 0.0),
        np.array([_squared_corner(view.pinhole) for view in views]),
        np.stack([_down(view, points) for view in views]),
        _blocks(points),
        np.array([view.pixels >= _MIN_PIXELS for view in views]),
    )


class PointFit:
    """Parameters of views (V,): ``gains`` (3, V), up to a common one, ``k`` (V,) of fall-off, and of ``waves`` (2, V)
    the sine and cosine, over ``turns`` (V,) from the first row to the last; None: no waves are fitted.
    """

    def __init__(self, points: SharedPoints) -> None:
        self._points, views = points, len(points.values)
        usable = [points.seen & unclipped(points.values[..., channel]) for channel in range(_CHANNELS)]
        self.usable = [each & (each.sum(axis=0) > 1) for each in usable]
        inside = [np.where(use, points.values[..., c], np.float32(0.5)) for c, use in enumerate(self.usable)]
        self._logs = [logit(each).astype(np.float64) for each in inside]
        self._slopes = [
            np.where(use, s * (1 - s), 0).astype(np.float64) for s, use in zip(inside, self.usable, strict=True)
        ]
        self.weights = [slope**2 for slope in self._slopes]
        self.gains, self.k, self.waves = np.zeros((_CHANNELS, views)), np.zeros(views), np.zeros((2, views))
        self.turns: F64 | None = None
        counts = np.min([use.sum(axis=1) for use in self.usable], axis=0)
        self.is_known = (counts >= _MIN_VIEW_POINTS) & points.is_large

    def fit(self, rounds: int = _ROUNDS) -> None:
        """Improves all parameters, where any view tells some."""
        if not self.is_known.any():
            return
        every = np.arange(self._logs[0].shape[1])
        for _ in range(rounds):
            self._step(_solved(*self._equations(every)))
            self._reweigh(every)

    def deviations(self) -> F64:
        """Standard deviations of ``k`` and of the waves, (1 or 3, V), by leaving out one block after the other."""
        parts = [self._equations(block) for block in self._points.blocks]
        normal, right = (np.sum([part[which] for part in parts], axis=0) for which in range(2))
        views = len(self.k)
        without = np.array(
            [_solved(normal - part, right - rest).reshape(-1, views)[_CHANNELS:] for part, rest in parts]
        )
        count = len(parts)
        return np.asarray(np.sqrt((count - 1) / count * ((without - without.mean(axis=0)) ** 2).sum(axis=0)))

    def errors(self, channel: int, points: NDArray[np.int64] | slice = slice(None)) -> F64:
        """Logits (V, P) of some points less what the views make of them; the points' own are left in."""
        return np.asarray(self._logs[channel][:, points] - self.gains[channel][:, None] - self._shade(points))

    def _shade(self, points: NDArray[np.int64] | slice) -> F64:
        dark = -2 * np.log1p(self.k[:, None] * self._points.tangents[:, points])
        return np.asarray(dark if self.turns is None else dark + np.log(self.light(points)))

    def light(self, points: NDArray[np.int64] | slice = slice(None)) -> F64:
        """Factors (V, P) of the waves."""
        assert self.turns is not None
        sine, cosine = self._turned(points)
        return np.asarray(
            np.maximum(1 + self.waves[0][:, None] * sine + self.waves[1][:, None] * cosine, _DARKEST_WAVE)
        )

    def _turned(self, points: NDArray[np.int64] | slice) -> tuple[F64, F64]:
        assert self.turns is not None
        angle = 2 * np.pi * self.turns[:, None] * self._points.down[:, points]
        return np.sin(angle), np.cos(angle)

    def _equations(self, points: NDArray[np.int64]) -> tuple[F64, F64]:
        """Normal equations of some points: unknowns by channel, then k, then the waves'."""
        tangents, views = self._points.tangents[:, points], len(self.k)
        shared = [-2 * tangents / (1 + self.k[:, None] * tangents)]
        if self.turns is not None:
            light = self.light(points)
            shared += [each / light for each in self._turned(points)]
        size = _CHANNELS + len(shared)
        normal, right = np.zeros((size, size, views, views)), np.zeros((size, views))
        for channel in range(_CHANNELS):
            weights = self.weights[channel][:, points]
            total = np.maximum(weights.sum(axis=0), 1e-12)
            error = self.errors(channel, points)
            error = error - (weights * error).sum(axis=0) / total
            columns = [(channel, np.ones_like(weights)), *enumerate(shared, start=_CHANNELS)]
            for one, first in columns:
                right[one] += (weights * first * error).sum(axis=1)
                for other, second in columns:
                    eliminated = np.einsum("vp,wp->vw", weights * first / total, weights * second)
                    normal[one, other] += np.diag((weights * first * second).sum(axis=1)) - eliminated
            for wave in range(_CHANNELS + 1, size):
                prior = _WAVE_PRIOR * weights.sum(axis=1)
                normal[wave, wave] += np.diag(prior)
                right[wave] -= prior * self.waves[wave - _CHANNELS - 1]
        for channel in range(_CHANNELS):  # the mean gain
            normal[channel, channel] += max(float(np.trace(normal[channel, channel])) / views**2, 1e-9)
        return normal.transpose(0, 2, 1, 3).reshape(size * views, size * views), right.ravel()

    def _step(self, step: F64) -> None:
        each = step.reshape(-1, len(self.k))
        self.gains = self.gains + each[:_CHANNELS]
        self.k = np.clip(self.k + each[_CHANNELS], -_MOST_BRIGHTER / self._points.corner, _LARGEST_K)
        if self.turns is not None:
            self.waves = self.waves + each[_CHANNELS + 1 :]

    def _reweigh(self, every: NDArray[np.int64]) -> None:
        for channel, (slope, use) in enumerate(zip(self._slopes, self.usable, strict=True)):
            weights, old = slope**2, self.weights[channel]
            errors = self.errors(channel, every)
            errors = errors - (old * errors).sum(axis=0) / np.maximum(old.sum(axis=0), 1e-12)
            weights[use] *= tukey_weights((slope * errors)[use].astype(np.float32))
            self.weights[channel] = weights


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


def _down(view: View, points: F64) -> F64:
    """Share (P,) of the recorded picture's height at which the points are; 0 where the view does not see them."""
    u, v, z = project(view.pinhole, points)
    inside = in_picture(view.pinhole, u, v, z)
    row, column = (np.where(inside, at, 0).astype(np.int64) for at in (v, u))
    down = np.broadcast_to(view.recorded_at.down, (view.pinhole.height, view.pinhole.width))
    return np.where(inside, down[row, column], 0.0)


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
