"""One cloud out of the views' candidates: evenly spread, at most so many, free of floaters, filled up where views stay empty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from .agreement import Candidates, depth_ratio
from .views import Array, View, inside, pixel_rays, project

CELL = 8
"""Side, in pixels, of the picture cells that should hold a point."""
_SEEN_THROUGH = 0.04
"""Share of its depth by which a point lies in front of what a view sees, when that view sees through it."""

_MOST_GUESSES = 4
"""Guesses per empty picture cell."""
_GUESS_CONFIDENCE = 0.05
_FEW_KNOWN = 0.01
"""Share of a view's pixels with confirmed depths below which points of other views tell its depths."""
_CLOSEST = 0.7
"""Pixels between points from which on more of them tell nothing new."""
_TRIALS = 10


@dataclass(frozen=True)
class Cloud:
    """``xyz`` (P, 3) float64 world, ``rgb`` (P, 3) 0..1, ``spacing`` (P,) world units, ``confidence`` (P,) 0..1."""

    xyz: NDArray[np.float64]
    rgb: Array
    spacing: Array
    confidence: Array

    def __len__(self) -> int:
        return len(self.xyz)


@dataclass(frozen=True)
class Sight:
    """Per point (P,): how many views see ``through`` it to something behind, how many see it ``in_place``; ``rgb`` (P, 3) is
    the mean of its own colour and of what the latter see."""

    through: NDArray[np.int64]
    in_place: NDArray[np.int64]
    rgb: Array


def empty_cloud() -> Cloud:
    """No points."""
    none = np.zeros(0, np.float32)
    return Cloud(np.zeros((0, 3)), np.zeros((0, 3), np.float32), none, none)


def join(clouds: Sequence[Cloud]) -> Cloud:
    """The points of all clouds, in order."""
    return Cloud(
        np.concatenate([c.xyz for c in clouds]),
        np.concatenate([c.rgb for c in clouds]),
        np.concatenate([c.spacing for c in clouds]),
        np.concatenate([c.confidence for c in clouds]),
    )


def take(cloud: Cloud, which: NDArray[np.integer] | NDArray[np.bool_]) -> Cloud:
    """The chosen points."""
    return Cloud(cloud.xyz[which], cloud.rgb[which], cloud.spacing[which], cloud.confidence[which])


def thin_candidates(candidates: Candidates, stride: int) -> Cloud:
    """The surest candidate of every ``stride`` x ``stride`` pixels of its picture."""
    block = (candidates.row // stride) * 65_536 + candidates.column // stride
    order = np.lexsort((-candidates.confidence, block))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(block[order]) != 0
    chosen = order[first]
    return Cloud(
        candidates.xyz[chosen], candidates.rgb[chosen], candidates.spacing[chosen], candidates.confidence[chosen]
    )


def _voxels(xyz: NDArray[np.float64], side: float) -> NDArray[np.int64]:
    """One number per voxel of this side; different voxels within 2**21 of each other get different numbers."""
    cells = np.floor(xyz / side).astype(np.int64) & ((1 << 21) - 1)
    return np.asarray((cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2])


def spread(cloud: Cloud, pixels: float) -> NDArray[np.int64]:
    """Indices of points about ``pixels`` picture pixels apart: the first one in every voxel, finest voxels first.

    The side of a point's voxel is its spacing times ``pixels``, rounded to half an octave; a voxel that holds a finer
    one's point gets none of its own.
    """
    if not len(cloud):
        return np.zeros(0, np.int64)
    level = np.round(np.log2(np.maximum(cloud.spacing.astype(np.float64) * pixels, 1e-30)) * 2).astype(np.int64)
    kept = np.zeros(0, np.int64)
    for at in np.unique(level):
        side = 2.0 ** (at / 2)
        members = np.concatenate([kept, np.flatnonzero(level == at)])
        _, first = np.unique(_voxels(cloud.xyz[members], side), return_index=True)
        fresh = first[first >= len(kept)]
        kept = np.concatenate([kept, members[np.sort(fresh)]])
    return kept


def spread_to_count(cloud: Cloud, most: int) -> tuple[Cloud, float]:
    """At most ``most`` evenly spread points, the surest ones, and how many pixels apart they are."""
    cloud = take(cloud, np.argsort(-cloud.confidence, kind="stable"))
    pixels, low, high, chosen = _CLOSEST, 0.0, np.inf, np.zeros(0, np.int64)
    for _ in range(_TRIALS):
        trial = spread(cloud, pixels)
        if len(trial) > most:
            low = pixels
        else:
            high, chosen = pixels, trial
            if len(trial) > 0.97 * most or low == 0:
                break
        guess = pixels * (len(trial) / (0.985 * most)) ** 0.6  # surfaces: the count falls with the square of the distance
        pixels = min(max(guess, 1.02 * low), 0.5 * (low + high) if high < np.inf else np.inf, 4 * max(low, _CLOSEST))
    if not len(chosen) and len(cloud):  # cannot be for surfaces; thin the surest evenly instead
        chosen = np.arange(0, len(cloud), -(-len(cloud) // most))
        high = pixels
    return take(cloud, chosen), float(high) if high < np.inf else _CLOSEST


def look_from_all(cloud: Cloud, views: Sequence[View], confirmed: Sequence[Array | None]) -> Sight:
    """What the views say of a cloud's points; ``confirmed``: per view inverse depths (H, W), 0 where unknown."""
    through, in_place = np.zeros(len(cloud), np.int64), np.zeros(len(cloud), np.int64)
    rgb = cloud.rgb.copy()
    for view, depths in zip(views, confirmed, strict=True):
        if depths is None:
            continue
        ratio, column, row = depth_ratio(view, depths, cloud.xyz)
        through += ratio < 1 - _SEEN_THROUGH
        here = np.abs(ratio - 1) <= _SEEN_THROUGH
        in_place += here
        rgb[here] += view.picture[row[here], column[here]]
    return Sight(through, in_place, rgb / (1 + in_place[:, None]).astype(np.float32))


def cell_counts(view: View, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    """Points per picture cell of 8 x 8 pixels, (rows, columns); what hides what is not looked at."""
    u, v, _ = project(view, xyz)
    visible = inside(view, u, v)
    columns, rows = -(-view.width // CELL), -(-view.height // CELL)
    cell = np.round(v[visible]).astype(np.int64) // CELL * columns + np.round(u[visible]).astype(np.int64) // CELL
    return np.bincount(cell, minlength=rows * columns).reshape(rows, columns)


def fill_depths(known: Array) -> Array:
    """Known inverse depths (H, W; 0: unknown) spread into the gaps, the far ones a little stronger; (H, W).

    Push and pull: unknown pixels get the mean of ever larger surroundings, until there is a known one.
    """
    weight = np.where(known > 0, 1 / np.maximum(known, 1e-12), 0).astype(np.float32)
    weight /= max(float(weight.max()), 1e-12)
    levels = [(known * weight, weight)]
    while min(levels[-1][0].shape) > 1 and (levels[-1][1] <= 1e-6).any():
        values, weights = levels[-1]
        size = (max(1, values.shape[1] // 2), max(1, values.shape[0] // 2))
        levels.append(
            (
                cv2.resize(values, size, interpolation=cv2.INTER_AREA),
                cv2.resize(weights, size, interpolation=cv2.INTER_AREA),
            )
        )
    values, weights = levels[-1]
    filled = np.full(values.shape, float(values.sum() / max(float(weights.sum()), 1e-12)), np.float32)
    for values, weights in reversed(levels):
        filled = cv2.resize(filled, values.shape[::-1], interpolation=cv2.INTER_LINEAR)
        enough = weights > 1e-6
        filled[enough] = values[enough] / weights[enough]
    return np.asarray(filled)


def projected_depths(view: View, xyz: NDArray[np.float64]) -> Array:
    """Inverse depths (H, W) of the nearest point in every pixel, 0 where there is none."""
    u, v, depth = project(view, xyz)
    visible = inside(view, u, v) & (depth > 0)
    column, row, depth = np.round(u[visible]).astype(np.int64), np.round(v[visible]).astype(np.int64), depth[visible]
    far_first = np.argsort(-depth, kind="stable")
    inverse = np.zeros((view.height, view.width), np.float32)
    inverse[row[far_first], column[far_first]] = 1 / depth[far_first]
    return inverse


def random_in_frustum(view: View, near: float, far: float, count: int, random: np.random.Generator) -> Cloud:
    """Random points of the view's colours, evenly over its picture and over inverse depth between ``near`` and ``far``."""
    column, row = random.integers(0, view.width, count), random.integers(0, view.height, count)
    depth = 1 / random.uniform(1 / far, 1 / near, count)
    return _guess(view, column, row, depth)


def _guess(view: View, column: NDArray[np.int64], row: NDArray[np.int64], depth: NDArray[np.float64]) -> Cloud:
    xyz = view.centre + pixel_rays(view, column.astype(np.float64), row.astype(np.float64)) * depth[:, None]
    spacing = (2 * depth / view.focal).astype(np.float32)
    return Cloud(xyz, view.picture[row, column], spacing, np.full(len(xyz), _GUESS_CONFIDENCE, np.float32))


def fill_empty_cells(
    view: View,
    cloud: Cloud,
    known: Array | None,
    believed: Array | None,
    pixels: float,
    random: np.random.Generator,
) -> Cloud:
    """Points for the cells of a view in which no point falls, ``pixels`` pixels apart.

    Half of them at the depth of known points around (``known`` (H, W) inverse depth, 0 unknown), with some scatter; the other
    half at the unconfirmed depth of the view's own sweep ``believed``, if there is one.
    """
    empty = np.argwhere(cell_counts(view, cloud.xyz) == 0)
    per_cell = min((CELL / pixels) ** 2, _MOST_GUESSES)
    wanted = int(np.ceil(len(empty) * per_cell))
    if not wanted:
        return empty_cloud()
    cell = empty[random.integers(0, len(empty), wanted)]
    column = np.minimum(cell[:, 1] * CELL + random.integers(0, CELL, wanted), view.width - 1)
    row = np.minimum(cell[:, 0] * CELL + random.integers(0, CELL, wanted), view.height - 1)
    if known is None or np.count_nonzero(known) < _FEW_KNOWN * known.size:
        known = projected_depths(view, cloud.xyz)
    filled = fill_depths(known)
    inverse = filled[row, column] * np.exp(0.05 * random.standard_normal(wanted))
    if believed is not None:
        low, high = np.percentile(known[known > 0], [1, 99]) if (known > 0).any() else (0.0, np.inf)
        own = believed[row, column]
        use = (random.random(wanted) < 0.5) & (own > 0.8 * low) & (own < 1.1 * high)
        inverse[use] = own[use]
    good = inverse > 1e-12
    return _guess(view, column[good], row[good], 1 / inverse[good])


def neighbour_distances(xyz: NDArray[np.float64]) -> Array:
    """Mean distance of every point to its three nearest, (P,); zeros for a single point."""
    count = min(3, len(xyz) - 1)
    if count < 1:
        return np.zeros(len(xyz), np.float32)
    middle = xyz.mean(axis=0)
    scale = max(float(np.abs(xyz - middle).max()), 1e-30)
    points = ((xyz - middle) / scale).astype(np.float32)
    index = cv2.flann.Index(points, {"algorithm": 4, "leaf_max_size": 10})  # exact single k-d tree
    _, squared = index.knnSearch(points, count + 1, params={"checks": -1})
    return np.asarray(np.sqrt(squared[:, 1:]).mean(axis=1) * scale, np.float32)
