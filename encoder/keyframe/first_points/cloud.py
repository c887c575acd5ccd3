"""One cloud from the views' candidates: evenly spread, of limited size, without floaters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.rig.numerics import nearest

from .agreement import Candidates, depth_ratio
from .frusta import DepthRange
from .views import Array, SweepView, inside, project

_IN_FRONT_FRACTION = 0.04
"""Relative depth by which a point lies in front of a view's surface if that view sees through it."""

_ON_SURFACE_FRACTION = 0.02
"""Relative difference of depth within which a point is what a view shows, and its colour there the point's."""

_MIN_SPACING_PIXELS = 0.7
"""Least useful distance between points, in pixels."""
_MAX_TRIALS = 10


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
class ViewDepths:
    """Depths of one view: ``swept`` (H, W), inverse depths of its sweep; ``confirmed`` (H, W), those consistent with
    other views, 0 elsewhere (both None without shared depths); ``nearest`` confirmed depth (0: unknown)."""

    view: SweepView
    depths: DepthRange | None
    swept: Array | None
    confirmed: Array | None
    nearest: float


@dataclass(frozen=True)
class Sight:
    """Number of views per point (P,) that see ``through`` it, and that see it ``in_place``; ``rgb`` (P, 3): mean of its
    own colour and of those in the latter views."""

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
    """Indices of points spaced about ``pixels`` picture pixels: the first one in every voxel, finest voxels first.

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
    """At most ``most`` evenly spread points, the most confident ones, and their spacing in pixels."""
    cloud = take(cloud, np.argsort(-cloud.confidence, kind="stable"))
    pixels, low, high, chosen = _MIN_SPACING_PIXELS, 0.0, np.inf, np.zeros(0, np.int64)
    for _ in range(_MAX_TRIALS):
        trial = spread(cloud, pixels)
        if len(trial) > most:
            low = pixels
        else:
            high, chosen = pixels, trial
            if len(trial) > 0.97 * most or low == 0:
                break
        guess = (
            pixels * (len(trial) / (0.985 * most)) ** 0.6
        )  # surfaces: the count falls with the square of the distance
        pixels = min(
            max(guess, 1.02 * low), 0.5 * (low + high) if high < np.inf else np.inf, 4 * max(low, _MIN_SPACING_PIXELS)
        )
    if not len(chosen) and len(cloud):  # cannot be for surfaces; thin the surest evenly instead
        chosen = np.arange(0, len(cloud), -(-len(cloud) // most))
        high = pixels
    return take(cloud, chosen), float(high) if high < np.inf else _MIN_SPACING_PIXELS


def look_from_all(cloud: Cloud, all_depths: Sequence[ViewDepths]) -> Sight:
    """Visibility of a cloud's points in all views."""
    through, in_place = np.zeros(len(cloud), np.int64), np.zeros(len(cloud), np.int64)
    rgb = cloud.rgb.copy()
    for view_depths in all_depths:
        if view_depths.confirmed is None:
            continue
        ratio, column, row = depth_ratio(view_depths.view, view_depths.confirmed, cloud.xyz)
        through += ratio < 1 - _IN_FRONT_FRACTION
        here = np.abs(ratio - 1) <= _IN_FRONT_FRACTION
        in_place += here
        rgb[here] += view_depths.view.picture[row[here], column[here]]
    return Sight(through, in_place, rgb / (1 + in_place[:, None]).astype(np.float32))


def shown_in(view_depths: ViewDepths, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Points (P,) that lie on the surface confirmed in a view."""
    if view_depths.confirmed is None:
        return np.zeros(len(xyz), bool)
    ratio, _, _ = depth_ratio(view_depths.view, view_depths.confirmed, xyz)
    return np.asarray(np.abs(ratio - 1) <= _ON_SURFACE_FRACTION)


def too_near(cloud: Cloud, all_depths: Sequence[ViewDepths], share: float) -> NDArray[np.bool_]:
    """Points (P,) right in front of a camera: nearer than ``share`` of the nearest depth confirmed in its view.

    Points on a camera in another camera's view would hide the scene from it.
    """
    near = np.zeros(len(cloud), bool)
    for view_depths in all_depths:
        u, v, depth = project(view_depths.view, cloud.xyz)
        near |= inside(view_depths.view, u, v) & (depth > 0) & (depth < share * view_depths.nearest)
    return near


def neighbour_distances(xyz: NDArray[np.float64]) -> Array:
    """Mean distance of every point to its three nearest, (P,); zeros for a single point."""
    count = min(3, len(xyz) - 1)
    if count < 1:
        return np.zeros(len(xyz), np.float32)
    middle = xyz.mean(axis=0)
    scale = max(float(np.abs(xyz - middle).max()), 1e-30)
    points = ((xyz - middle) / scale).astype(np.float32)
    _, squared = nearest(points, count + 1)
    return np.asarray(np.sqrt(squared[:, 1:]).mean(axis=1) * scale, np.float32)
