"""First points from the rig itself: a coloured cloud for the keyframe, from poses and pictures of frame 0 alone.

A coarse plane sweep over the depths the cameras share finds where things are, a fine one over just these depths finds the
surfaces, agreement between views decides what to believe, and gaps are filled with guesses. Points from elsewhere (COLMAP) join.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.errors import TrainingError

from .agreement import Candidates, agree
from .cloud import (
    Cloud,
    empty_cloud,
    fill_empty_cells,
    join,
    look_from_all,
    neighbour_distances,
    random_in_frustum,
    spread_to_count,
    take,
    thin_candidates,
)
from .frusta import RAY_GRID, DepthRange, choose_neighbours, ray_grid, rig_size, shared_depths
from .plane_sweep import DepthMap, choose_planes, sweep
from .views import Array, View, inside, make_view, project

__all__ = ["FirstPoints", "KnownPoints", "first_points"]

_FINE_PIXELS, _ALL_FINE_PIXELS = 250_000, 4_000_000
_COARSE_PIXELS = 14_000
"""Largest pictures of the sweeps, in pixels: one view's, all views' together, one view's in the coarse sweep."""
_MOST_PLANES = 128
_MATCHED, _COMPARED = 4, 8
"""Neighbours a view is matched with, and those its depths are compared with."""
_FEWEST_POINTS = 200
"""Points of the coarse sweep in a view from which on they tell its depth range."""

_COARSE_CONFIDENCE = 0.5
_CONFIRMED_SHARE = 0.85
"""Share of the room for points that confirmed ones may take; the rest is kept for guesses."""
_GUESSES_WITHOUT_POINTS = 20_000

R = TypeVar("R")


class KnownPoints(Protocol):
    """Points from elsewhere: ``xyz`` (P, 3) world, ``rgb`` (P, 3) uint8."""

    @property
    def xyz(self) -> NDArray[np.float32]: ...
    @property
    def rgb(self) -> NDArray[np.uint8]: ...


@dataclass(frozen=True)
class FirstPoints:
    """Where training starts.

    ``xyz`` (P, 3) world; ``rgb`` (P, 3) 0..1; ``spacing`` (P,) world units, the size one point has to cover (mean distance to
    its three nearest, within bounds); ``confidence`` (P,) 0..1, 0.05 for a guess.
    """

    xyz: NDArray[np.float32]
    rgb: NDArray[np.float32]
    spacing: NDArray[np.float32]
    confidence: NDArray[np.float32]


def first_points(
    cameras: Sequence[Camera],
    pictures: Sequence[NDArray[np.float32]],
    *,
    known: KnownPoints | None = None,
    cap: int,
    seed: int = 0,
    threads: int = 0,
) -> FirstPoints:
    """At most ``cap`` coloured points on the surfaces the training views see, spread evenly over the pictures.

    ``cameras``: pinhole; ``pictures``: (H, W, 3) RGB 0..1 of the same cameras; ``known``: points to use as well. The
    result depends on ``seed`` (guesses where views stay empty), not on ``threads`` (0: all cores). Cameras whose views share
    nothing give guesses only. Raises TrainingError for fewer than two cameras (or cameras all in one place) without known points.
    """
    if len(cameras) != len(pictures) or cap < 1:
        raise TrainingError(f"first points need one picture per camera and room for points, got {len(cameras)}, {len(pictures)}, {cap}")
    for camera, picture in zip(cameras, pictures, strict=True):
        if picture.shape != (camera.height, camera.width, 3):
            raise TrainingError(f"{camera.name}: the picture is {picture.shape}, the camera {camera.width}x{camera.height}")
    own_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)  # views are worked on side by side; OpenCV's own threads would only get in the way
    try:
        with ThreadPoolExecutor(threads or len(os.sched_getaffinity(0))) as pool:
            return _first_points(cameras, pictures, known, cap, np.random.default_rng(seed), pool)
    finally:
        cv2.setNumThreads(own_threads)


def _first_points(
    cameras: Sequence[Camera],
    pictures: Sequence[Array],
    known: KnownPoints | None,
    cap: int,
    random: np.random.Generator,
    pool: ThreadPoolExecutor,
) -> FirstPoints:
    if len(cameras) < 2 and (known is None or not len(known.xyz)):
        raise TrainingError("one training camera tells nothing of depth: use at least two, or a rig with known points")
    in_all = sum(camera.width * camera.height for camera in cameras)
    fine_scale = [
        min(1.0, (_FINE_PIXELS / (c.width * c.height)) ** 0.5, (_ALL_FINE_PIXELS / in_all) ** 0.5) for c in cameras
    ]
    coarse_scale = [min(1.0, (_COARSE_PIXELS / (c.width * c.height)) ** 0.5) for c in cameras]
    coarse = _run(pool, make_view, cameras, pictures, coarse_scale)
    fine = _run(pool, make_view, cameras, pictures, fine_scale)
    given = _known_cloud(known, fine)
    if rig_size(fine) <= 0 and not len(given):
        raise TrainingError("all training cameras stand in one place, which tells nothing of depth: use a rig with known points")

    shared = shared_depths(coarse)
    samples = [_within(view, depths) for view, depths in zip(coarse, shared, strict=True)]
    found, _ = _sweep_all(pool, coarse, shared, samples)
    rough = np.concatenate([*(c.xyz for c in found if c is not None), given.xyz.astype(np.float64)])
    ranges = [_depth_range(view, rough, depths) for view, depths in zip(fine, shared, strict=True)]
    samples = [_likely_points(view, rough, depths) for view, depths in zip(fine, ranges, strict=True)]
    candidates, maps = _sweep_all(pool, fine, ranges, samples)

    total = sum(len(c.xyz) for c in candidates if c is not None)
    stride = max(1, int((total / (3.0 * cap)) ** 0.5))
    confirmed = [
        _confirmed_depths(view, c) if c is not None else None for view, c in zip(fine, candidates, strict=True)
    ]
    clouds = [thin_candidates(c, stride) for c in candidates if c is not None]
    clouds += [_rough_points(*four) for four in zip(coarse, found, fine, confirmed, strict=True) if four[1] is not None]
    pool_of_points = join([given, *clouds])

    def chosen(most: int) -> tuple[Cloud, float]:
        cloud, pixels = spread_to_count(pool_of_points, most)
        sight = look_from_all(cloud, fine, confirmed)
        keep = (sight.through <= 1) | (2 * sight.through <= sight.in_place)
        return take(replace(cloud, rgb=sight.rgb), keep), pixels

    most = max(1, round(cap * _CONFIRMED_SHARE))
    cloud, pixels = chosen(most)
    guesses = _guesses(cloud, fine, ranges, confirmed, maps, pixels, random)
    room = cap - len(guesses)
    if room > most and len(cloud) < len(pool_of_points):
        cloud, pixels = chosen(room)
    room = cap - len(cloud)
    if len(guesses) > room:
        guesses = take(guesses, np.sort(random.permutation(len(guesses))[:room]))
    return _finish(join([cloud, guesses]), pixels)


def _run(pool: ThreadPoolExecutor, work: Callable[..., R], *arguments: Sequence[object]) -> list[R]:
    """Results of ``work`` over all views, in order."""
    return list(pool.map(work, *arguments))


def _sweep_all(
    pool: ThreadPoolExecutor,
    views: Sequence[View],
    ranges: Sequence[DepthRange | None],
    samples: Sequence[NDArray[np.float64]],
) -> tuple[list[Candidates | None], list[DepthMap | None]]:
    """What every view proposes and its depth map; None for views that share nothing with others."""
    neighbours = choose_neighbours(views, samples, _COMPARED)

    def depth_map(i: int) -> DepthMap | None:
        depths, matched = ranges[i], [views[j] for j in neighbours[i][:_MATCHED]]
        if depths is None or not matched:
            return None
        return sweep(views[i], matched, choose_planes(views[i], matched, depths, _MOST_PLANES))

    def candidates(i: int) -> Candidates | None:
        own = maps[i]
        return None if own is None else agree(views, i, neighbours[i], neighbours[i][:_MATCHED], own, maps)

    maps = _run(pool, depth_map, range(len(views)))
    return _run(pool, candidates, range(len(views))), maps


def _within(view: View, depths: DepthRange | None) -> NDArray[np.float64]:
    """World points (S, 3) all over the depths the view shares with others, evenly in inverse depth."""
    if depths is None:
        return np.zeros((0, 3))
    steps = 1 / np.linspace(1 / depths.far, 1 / depths.near, 16)
    return np.asarray((view.centre + ray_grid(view) * steps[:, None, None]).reshape(-1, 3))


def _depth_range(view: View, xyz: NDArray[np.float64], shared: DepthRange | None) -> DepthRange | None:
    """Depths of the points found so far in a view, with a margin; all it shares with others if there are too few."""
    u, v, depth = project(view, xyz)
    depth = depth[inside(view, u, v) & (depth > 0)]
    if len(depth) < _FEWEST_POINTS:
        return shared
    near, far = np.percentile(depth, [0.1, 99.9])
    return DepthRange(float(near) * 0.9, float(far) * 1.15)


def _likely_points(view: View, xyz: NDArray[np.float64], depths: DepthRange | None) -> NDArray[np.float64]:
    """World points (S, 3), one per cell of the view: at the median depth of what was found in it, or in the whole view."""
    if depths is None:
        return np.zeros((0, 3))
    u, v, depth = project(view, xyz)
    rays = ray_grid(view)
    columns, rows = RAY_GRID
    visible = inside(view, u, v) & (depth > 0)
    if not visible.any():
        return _within(view, depths)
    column = np.clip((u[visible] + 0.5) / view.width * columns, 0, columns - 1).astype(np.int64)
    row = np.clip((v[visible] + 0.5) / view.height * rows, 0, rows - 1).astype(np.int64)
    cell, depth = row * columns + column, depth[visible]
    everywhere = float(np.median(depth))
    likely = np.array([np.median(depth[cell == k]) if (cell == k).any() else everywhere for k in range(len(rays))])
    return np.asarray(view.centre + rays * likely[:, None])


def _known_cloud(known: KnownPoints | None, views: Sequence[View]) -> Cloud:
    """The given points as a cloud; their spacing is a pixel of the view nearest to them that sees them."""
    if known is None or not len(known.xyz):
        return empty_cloud()
    xyz = np.asarray(known.xyz, np.float64)
    spacing = np.full(len(xyz), np.inf)
    for view in views:
        u, v, depth = project(view, xyz)
        seen = inside(view, u, v) & (depth > 0)
        spacing[seen] = np.minimum(spacing[seen], depth[seen] / view.focal)
    cloud = Cloud(
        xyz, np.asarray(known.rgb, np.float32) / 255, spacing.astype(np.float32), np.ones(len(xyz), np.float32)
    )
    return take(cloud, np.isfinite(spacing) & np.isfinite(xyz).all(axis=1))


def _rough_points(coarse: View, candidates: Candidates, fine: View, confirmed: Array | None) -> Cloud:
    """Points of the coarse sweep where the fine one confirms nothing: little texture, very different views."""
    cloud = thin_candidates(candidates, 1)
    cloud = replace(cloud, confidence=_COARSE_CONFIDENCE * cloud.confidence)
    if confirmed is None:
        return cloud
    reach = 2 * round(fine.width / coarse.width) + 1
    covered = cv2.dilate((confirmed > 0).astype(np.uint8), np.ones((reach, reach), np.uint8))
    u, v, _ = project(fine, cloud.xyz)
    column = np.clip(np.round(u), 0, fine.width - 1).astype(np.int64)
    row = np.clip(np.round(v), 0, fine.height - 1).astype(np.int64)
    return take(cloud, covered[row, column] == 0)


def _confirmed_depths(view: View, candidates: Candidates) -> Array:
    """Inverse depths (H, W) of the pixels other views confirm, 0 elsewhere."""
    depths = np.zeros((view.height, view.width), np.float32)
    depths[candidates.row, candidates.column] = candidates.inverse_depth
    return depths


def _guesses(
    cloud: Cloud,
    views: Sequence[View],
    ranges: Sequence[DepthRange | None],
    confirmed: Sequence[Array | None],
    maps: Sequence[DepthMap | None],
    pixels: float,
    random: np.random.Generator,
) -> Cloud:
    """Points where views have none: near what is known, or anywhere in the frusta if nothing is."""
    guesses = [empty_cloud()]
    if not len(cloud):
        size = rig_size(views) or 1.0
        each = max(1, _GUESSES_WITHOUT_POINTS // len(views))
        for view, depths in zip(views, ranges, strict=True):
            depths = depths or DepthRange(size / 2, size * 5)
            guesses.append(random_in_frustum(view, depths.near, depths.far, each, random))
    else:
        for view, known, depths in zip(views, confirmed, maps, strict=True):
            so_far = join([cloud, *guesses])
            guess = fill_empty_cells(
                view, so_far, known, None if depths is None else depths.inverse_depth, 2 * pixels, random
            )
            guesses.append(take(guess, look_from_all(guess, views, confirmed).through == 0))
    return join(guesses)


def _finish(cloud: Cloud, pixels: float) -> FirstPoints:
    nominal = cloud.spacing * np.float32(pixels)
    distances = neighbour_distances(cloud.xyz)
    return FirstPoints(
        xyz=cloud.xyz.astype(np.float32),
        rgb=np.clip(cloud.rgb, 0, 1).astype(np.float32),
        spacing=np.clip(distances, 0.5 * nominal, 3 * nominal),
        confidence=cloud.confidence,
    )
