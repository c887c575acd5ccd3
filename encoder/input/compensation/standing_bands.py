"""Bands of lamps that stand still, at the keyframe's first points: a wave over the rows of each camera's pictures.

Where lamps pulse a whole number of times from frame to frame (100 Hz at 25 and 50 frames a second), time tells nothing,
but cameras that see a point in other rows see it in other light. The wave's turns over the rows are tried out, against
what the other cameras see of the same points, and fitted together with gains and fall-off (`point_fit.py`). Lamps light
a whole room: bands count where most cameras surely have some.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import ALWAYS_LIT, LAMP_STEP, LARGEST, Correction, Corrections, LampWave
from decogs.rig.pictures.ingest import View

from .point_fit import PointFit, SharedPoints

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_TURNS = np.arange(1.0, 4.01, 0.05)
"""Of a wave from the first row to the last that are tried: of less than one, a gradient of the scene's own light is as
likely."""
_ROUNDS, _FIT_ROUNDS = 3, 3
_SOME_POINTS = 3000
"""Points that a first look takes."""
_MIN_FIRST_SHARE = 0.1
"""Of what the other cameras do not explain, that a wave must explain in the middle camera for a second look."""
_MIN_SHARE, _MIN_DEVIATIONS = 0.3, 7.0
"""The same share, and deviations of the wave from none, from which a camera's is sure: .31 and 9 are the most of single
cameras without, .26 and 6.5 the most of a rig's middle one."""


def find_bands(points: SharedPoints, fit: PointFit) -> tuple[PointFit, BoolArray]:
    """The ``fit`` with waves, and the views (V,) that surely have one; the same fit, and none, where few have."""
    none = np.zeros(len(fit.k), bool)
    if not fit.is_known.any():
        return fit, none
    some = slice(None, None, max(1, points.seen.shape[1] // _SOME_POINTS))
    _, shares = _tried(points, fit, some)
    if np.median(shares[fit.is_known]) < _MIN_FIRST_SHARE:
        return fit, none
    waved = deepcopy(fit)
    for _ in range(_ROUNDS):
        turns, shares = _tried(points, waved, slice(None))
        waved.turns = turns
        waved.fit(_FIT_ROUNDS)
    deviations = np.hypot(*waved.deviations()[1:])
    strengths = np.hypot(*waved.waves)
    sure = fit.is_known & (shares >= _MIN_SHARE) & (strengths >= _MIN_DEVIATIONS * np.maximum(deviations, 1e-9))
    return (waved, sure) if 2 * sure.sum() > fit.is_known.sum() else (fit, none)


def band_corrections(views: Sequence[View], fit: PointFit, sure: BoolArray, hertz: float) -> Corrections:
    """The constant corrections of cameras that are ``sure`` (V,) to have bands, by camera; lamps pulse at ``hertz``."""
    corrections = {}
    for row in np.flatnonzero(sure).tolist():
        assert fit.turns is not None
        sine, cosine = (min(max(round(float(wave[row]) / LAMP_STEP), -LARGEST), LARGEST) for wave in fit.waves)
        wave = LampWave(hertz, float(fit.turns[row]) / hertz, 1, 1, (sine,) * 3, (cosine,) * 3)
        corrections[views[row].camera.name] = Correction(lamp=wave, lamp_amplitude=ALWAYS_LIT)
    return corrections


def _tried(points: SharedPoints, fit: PointFit, some: slice) -> tuple[F64, F64]:
    """The best turns (V,) of each view's wave, and the share (V,) that it explains, of ``some`` of the points."""
    views = len(fit.k)
    errors = [fit.errors(channel, some) for channel in range(len(fit.gains))]
    weights = [each[:, some] for each in fit.weights]
    light = np.zeros_like(errors[0]) if fit.turns is None else np.log(fit.light(some))
    turns, shares = np.full(views, _TURNS[0]), np.zeros(views)
    for view in range(views):
        rest, each = [], []
        for error, weight in zip(errors, weights, strict=True):
            others = np.delete(weight, view, axis=0)
            total = others.sum(axis=0)
            by_others = (others * np.delete(error, view, axis=0)).sum(axis=0) / np.maximum(total, 1e-12)
            rest.append(error[view] + light[view] - by_others)
            each.append(weight[view] * total / np.maximum(weight[view] + total, 1e-12))
        turns[view], shares[view] = _best(np.stack(rest), np.stack(each), points, view, some)
    return turns, shares


def _best(rest: F64, weights: F64, points: SharedPoints, view: int, some: slice) -> tuple[float, float]:
    """The turns of the wave that explains most of the ``rest`` (3, P), beside gains and fall-off, and its share."""
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)

    def centred(columns: F64) -> F64:
        """Columns (..., P) in each channel (..., 3, P), without their means there."""
        columns = np.broadcast_to(columns[..., None, :], (*columns.shape[:-1], *weights.shape))
        return np.asarray(columns - (weights * columns).sum(axis=-1, keepdims=True) / total)

    rest = rest - (weights * rest).sum(axis=1, keepdims=True) / total
    slope = centred(points.tangents[view, some])
    power = max(float((weights * slope * slope).sum()), 1e-12)

    def without_slope(columns: F64) -> F64:
        return np.asarray(columns - ((weights * columns * slope).sum(axis=(-2, -1)) / power)[..., None, None] * slope)

    rest = without_slope(rest)
    angles = 2 * np.pi * np.asarray(_TURNS)[:, None] * points.down[view, some]
    sine, cosine = without_slope(centred(np.sin(angles))), without_slope(centred(np.cos(angles)))
    a, b, c = (
        (weights * one * other).sum(axis=(1, 2)) for one, other in ((sine, sine), (sine, cosine), (cosine, cosine))
    )
    x, y = ((weights * one * rest).sum(axis=(1, 2)) for one in (sine, cosine))
    explained = (c * x * x - 2 * b * x * y + a * y * y) / np.maximum(a * c - b * b, 1e-12)
    best = int(explained.argmax())
    return float(_TURNS[best]), float(explained[best] / max((weights * rest * rest).sum(), 1e-12))
