"""Guessed points where views have none, so that training starts with points everywhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .cloud import Cloud, ViewDepths, empty_cloud, join, look_from_all, take, too_near
from .depth_filling import fill_depths
from .frusta import DepthRange, rig_size
from .views import Array, SweepView, inside, pixel_rays, project

CELL = 8
"""Side, in pixels, of picture cells, each of which gets a point."""
_APART = 2.4
"""Distance between guesses over that between confirmed points: more of them would not know their places better."""
_BELIEVED = 0.5
"""Share of the guesses at the unconfirmed depth of the view's own sweep, where it is plausible."""
_SCATTER, _WIDE_SCATTER = 0.02, 0.5
"""Relative standard deviation of the depth of the other guesses around that of known points near them: in a view in
which enough is confirmed, and in one in which nothing is."""
_ENOUGH = 0.4
"""Sufficient share of confirmed pixels."""
_CONFIDENCE = 0.05
_FEW_KNOWN = 0.01
"""Share of a view's pixels with confirmed depths below which points of other views give its depths."""
_WITHOUT_POINTS = 20_000
"""Total number of guesses without any confirmed point."""
_CLEAR = 0.9
"""Share of the nearest confirmed depth of any view that sees it at which a guess must lie at least."""


def guess_points(cloud: Cloud, all_depths: Sequence[ViewDepths], pixels: float, random: np.random.Generator) -> Cloud:
    """Points where views have none of ``cloud``: near known points, or anywhere in the frusta without these.

    ``pixels``: distance between the points of ``cloud`` in a picture.
    """
    found = [empty_cloud()]
    if not len(cloud):
        size = rig_size([view_depths.view for view_depths in all_depths]) or 1.0
        each = max(1, _WITHOUT_POINTS // len(all_depths))
        for view_depths in all_depths:
            depths = view_depths.depths or DepthRange(size / 2, size * 5)
            found.append(random_in_frustum(view_depths.view, depths, each, random))
        return join(found)
    for view_depths in all_depths:
        guess = fill_empty_cells(view_depths, join([cloud, *found]), pixels, random)
        wrong = (look_from_all(guess, all_depths).through > 0) | too_near(guess, all_depths, _CLEAR)
        found.append(take(guess, ~wrong))
    return join(found)


def cell_counts(view: SweepView, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    """Points per picture cell of 8 x 8 pixels, (rows, columns), without regard to occlusion."""
    u, v, _ = project(view, xyz)
    visible = inside(view, u, v)
    columns, rows = -(-view.width // CELL), -(-view.height // CELL)
    cell = np.round(v[visible]).astype(np.int64) // CELL * columns + np.round(u[visible]).astype(np.int64) // CELL
    return np.bincount(cell, minlength=rows * columns).reshape(rows, columns)


def projected_depths(view: SweepView, xyz: NDArray[np.float64]) -> Array:
    """Inverse depths (H, W) of the nearest point in every pixel, 0 where there is none."""
    u, v, depth = project(view, xyz)
    visible = inside(view, u, v) & (depth > 0)
    column, row, depth = np.round(u[visible]).astype(np.int64), np.round(v[visible]).astype(np.int64), depth[visible]
    far_first = np.argsort(-depth, kind="stable")
    inverse = np.zeros((view.height, view.width), np.float32)
    inverse[row[far_first], column[far_first]] = 1 / depth[far_first]
    return inverse


def random_in_frustum(view: SweepView, depths: DepthRange, count: int, random: np.random.Generator) -> Cloud:
    """Random points of the view's colours, evenly over its picture and over inverse depth."""
    column, row = random.integers(0, view.width, count), random.integers(0, view.height, count)
    return _guess(view, column, row, 1 / random.uniform(1 / depths.far, 1 / depths.near, count))


def _guess(view: SweepView, column: NDArray[np.int64], row: NDArray[np.int64], depth: NDArray[np.float64]) -> Cloud:
    xyz = view.centre + pixel_rays(view, column.astype(np.float64), row.astype(np.float64)) * depth[:, None]
    spacing = (_APART * depth / view.focal).astype(np.float32)
    return Cloud(xyz, view.picture[row, column], spacing, np.full(len(xyz), _CONFIDENCE, np.float32))


def fill_empty_cells(view_depths: ViewDepths, cloud: Cloud, pixels: float, random: np.random.Generator) -> Cloud:
    """Points for the cells of a view in which no point of ``cloud`` falls.

    Their depths are those of known points around, with some scatter, or unconfirmed ones of the view's sweep.
    """
    view = view_depths.view
    empty = np.argwhere(cell_counts(view, cloud.xyz) == 0)
    wanted = int(np.ceil(len(empty) * min((CELL / (_APART * pixels)) ** 2, 4.0)))
    if not wanted:
        return empty_cloud()
    cell = empty[random.integers(0, len(empty), wanted)]
    column = np.minimum(cell[:, 1] * CELL + random.integers(0, CELL, wanted), view.width - 1)
    row = np.minimum(cell[:, 0] * CELL + random.integers(0, CELL, wanted), view.height - 1)
    known = view_depths.confirmed
    if known is None or np.count_nonzero(known) < _FEW_KNOWN * known.size:
        known = projected_depths(view, cloud.xyz)
    doubt = 1 - min(1.0, np.count_nonzero(known) / (_ENOUGH * known.size))
    scatter = _SCATTER + (_WIDE_SCATTER - _SCATTER) * doubt
    inverse = fill_depths(known)[row, column] * np.exp(scatter * random.standard_normal(wanted))
    if view_depths.believed is not None and known.any():
        low, high = np.percentile(known[known > 0], [1, 99])
        own = view_depths.believed[row, column]
        use = (random.random(wanted) < _BELIEVED) & (own > 0.8 * low) & (own < 1.1 * high)
        inverse[use] = own[use]
    good = inverse > 1e-12
    return _guess(view, column[good], row[good], 1 / inverse[good])
