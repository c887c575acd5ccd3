"""Shared depths of views and neighbours for matching, from the cameras' poses and points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .views import SweepView, inside, pixel_rays, project

RAY_GRID = (12, 9)
_SAMPLED_DEPTHS = 64
_MAX_DEPTH_RATIO = 400.0
"""Ratio of farthest to nearest depth searched, in a rig whose views overlap up to infinity."""
_MIN_OVERLAP = 0.1
"""Least share of a view's pixels that another view sees at a shared depth."""
_PEAK_FRACTION = 0.25
_MIN_RANGE_POINTS = 200
"""Least points in a view for its depth range to come from them."""


@dataclass(frozen=True)
class DepthRange:
    """Depth range of a view's search, along the optical axis, in world units."""

    near: float
    far: float


def ray_grid(view: SweepView) -> NDArray[np.float64]:
    """World directions of a coarse grid of the view's recorded pixels, (G, 3), at unit depth."""
    u, v = _grid_pixels(view)
    kept = inside(view, u, v)
    return pixel_rays(view, u[kept], v[kept])


def _grid_pixels(view: SweepView) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows (G,) of the middles of the grid's cells."""
    u, v = np.meshgrid(
        (np.arange(RAY_GRID[0]) + 0.5) / RAY_GRID[0] * view.width - 0.5,
        (np.arange(RAY_GRID[1]) + 0.5) / RAY_GRID[1] * view.height - 0.5,
    )
    return u.ravel(), v.ravel()


def rig_size(views: Sequence[SweepView]) -> float:
    """Largest distance between two cameras, world units; 0 if all stand in one place."""
    centres = np.array([view.centre for view in views])
    return float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max())


def angle_weight(degrees: NDArray[np.floating]) -> NDArray[np.float64]:
    """Usefulness for matching of this angle between two views' rays to a point: 1 from 6 to 16 degrees, 0 at 0.

    Smaller angles hardly constrain depth; under larger ones the pictures differ.
    """
    small = np.minimum(degrees / 6.0, 1.0)
    return np.asarray(small * np.exp(-(np.maximum(degrees - 16.0, 0.0) ** 2) / (2 * 13.0**2)))


def shared_depths(views: Sequence[SweepView]) -> list[DepthRange | None]:
    """For every view the depths at which other views see a fair part of the same space; None if there are none.

    Nearest: where the weight for matching (best other view of each pixel, see ``angle_weight``) reaches a quarter of
    its largest value; closer up, cameras beside each other see different space, or the same under very different
    angles. Farthest: where the last of the shared space is, up to "infinity" (20 times the rig's size).
    """
    size = rig_size(views)
    if size <= 0:
        return [None] * len(views)
    depths = size * np.geomspace(2.0 / _MAX_DEPTH_RATIO, _MAX_DEPTH_RATIO / 20, _SAMPLED_DEPTHS)
    ranges: list[DepthRange | None] = []
    for i, view in enumerate(views):
        xyz = view.centre + ray_grid(view)[None] * depths[:, None, None]
        seen = np.zeros(xyz.shape[:2], bool)
        weight = np.zeros(xyz.shape[:2])
        for j, other in enumerate(views):
            if j != i:
                u, v, _ = project(other, xyz)
                visible = inside(other, u, v)
                seen |= visible
                np.maximum(weight, visible * angle_weight(_angles(xyz, view, other)), out=weight)
        shared = seen.mean(axis=1) >= _MIN_OVERLAP
        weight_at = weight.mean(axis=1)
        shared &= (weight_at >= _PEAK_FRACTION * weight_at.max()) | (np.arange(_SAMPLED_DEPTHS) > weight_at.argmax())
        indices = np.flatnonzero(shared)
        ranges.append(DepthRange(float(depths[indices[0]]), float(depths[indices[-1]])) if indices.size else None)
    return ranges


def _angles(xyz: NDArray[np.float64], a: SweepView, b: SweepView) -> NDArray[np.float64]:
    """Angles, in degrees, under which two cameras see points (..., 3)."""
    to_a, to_b = xyz - a.centre, xyz - b.centre
    lengths = np.linalg.norm(to_a, axis=-1) * np.linalg.norm(to_b, axis=-1)
    cosines = (to_a * to_b).sum(axis=-1) / np.maximum(lengths, 1e-12)
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))))


def median_angle(xyz: NDArray[np.float64], a: SweepView, b: SweepView) -> float:
    """Angle, in degrees, under which two cameras see the median of the points (P, 3), at least one, in b's picture."""
    u, v, _ = project(b, xyz)
    shown = inside(b, u, v)
    return float(np.median(_angles(xyz[shown] if shown.any() else xyz, a, b)))


def choose_neighbours(
    views: Sequence[SweepView], samples: Sequence[NDArray[np.float64]], count: int
) -> list[list[int]]:
    """For every view up to ``count`` others to match it with, best first.

    ``samples``: per view world points (S, 3) it may be looking at. Weight: the share of these the other view sees under
    a helpful angle; views in the same direction as one already chosen count less: they are occluded together.
    """
    chosen_of_all: list[list[int]] = []
    for i, view in enumerate(views):
        xyz = samples[i]
        weight = np.zeros(len(views))
        for j, other in enumerate(views):
            if j == i or not len(xyz):
                continue
            u, v, _ = project(other, xyz)
            weight[j] = np.mean(angle_weight(_angles(xyz, view, other)) * inside(other, u, v))
        directions = np.array([other.centre - view.centre for other in views])
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
        chosen: list[int] = []
        floor = 0.02 * weight.max(initial=0.0)
        left = weight.copy()
        while len(chosen) < count and left.max() > max(floor, 1e-6):
            best = int(left.argmax())
            chosen.append(best)
            left[best] = 0
            left *= 1 - 0.5 * np.maximum(directions @ directions[best], 0) ** 4
        chosen_of_all.append(chosen)
    return chosen_of_all


def points_within(view: SweepView, depths: DepthRange | None) -> NDArray[np.float64]:
    """World points (S, 3) all over the depths the view shares with others, evenly in inverse depth."""
    if depths is None:
        return np.zeros((0, 3))
    steps = 1 / np.linspace(1 / depths.far, 1 / depths.near, 16)
    return np.asarray((view.centre + ray_grid(view) * steps[:, None, None]).reshape(-1, 3))


def depths_of(
    view: SweepView, own: NDArray[np.float64], all_views: NDArray[np.float64], shared: DepthRange | None
) -> DepthRange | None:
    """Depth range of a view's fine search, with a margin; ``shared`` if too few points are known.

    ``own`` (P, 3): points found in this view; ``all_views`` (Q, 3): in all, without the nearest and farthest hundredth,
    which include the camera's own housing and occluded points.
    """
    depth = (own - view.centre) @ view.rotation[2]
    u, v, others = project(view, all_views)
    others = others[inside(view, u, v) & (others > 0)]
    if len(others) < _MIN_RANGE_POINTS:
        return shared
    near, far = np.percentile(others, [1, 99])
    if len(depth) >= _MIN_RANGE_POINTS:
        near, far = min(near, np.percentile(depth, 0.1)), max(far, np.percentile(depth, 99.9))
    return DepthRange(float(near) * 0.9, float(far) * 1.15)


def likely_points(view: SweepView, xyz: NDArray[np.float64], depths: DepthRange | None) -> NDArray[np.float64]:
    """World points (S, 3), one per cell of the view, at the median depth of the points in it or in all cells."""
    if depths is None:
        return np.zeros((0, 3))
    u, v, depth = project(view, xyz)
    across, down = _grid_pixels(view)
    columns, rows = RAY_GRID
    visible = inside(view, u, v) & (depth > 0)
    if not visible.any():
        return points_within(view, depths)
    column = np.clip((u[visible] + 0.5) / view.width * columns, 0, columns - 1).astype(np.int64)
    row = np.clip((v[visible] + 0.5) / view.height * rows, 0, rows - 1).astype(np.int64)
    cell, depth = row * columns + column, depth[visible]
    likely = _medians(depth, cell, columns * rows)
    likely[np.isnan(likely)] = np.median(depth)
    kept = inside(view, across, down)
    return np.asarray(view.centre + pixel_rays(view, across[kept], down[kept]) * likely[kept, None])


def _medians(values: NDArray[np.float64], cell: NDArray[np.int64], cells: int) -> NDArray[np.float64]:
    """The median of the values in each of so many cells, NaN where there is none."""
    order = np.lexsort((values, cell))
    ordered, numbers = values[order], cell[order]
    begin, end = (np.searchsorted(numbers, np.arange(cells), side) for side in ("left", "right"))
    filled = np.flatnonzero(end > begin)
    medians = np.full(cells, np.nan)
    last = end[filled] + begin[filled]
    medians[filled] = (ordered[(last - 1) // 2] + ordered[last // 2]) / 2
    return medians
