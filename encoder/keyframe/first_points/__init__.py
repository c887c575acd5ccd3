"""First points from the rig itself: a coloured cloud for the keyframe, from poses and pictures of frame 0 alone.

A coarse plane sweep over the cameras' shared depths finds the depth range, and a fine sweep over this range finds the
surfaces. Consistency between views confirms points, and guesses fill gaps. Points from elsewhere (COLMAP) join.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.errors import TrainingError
from decogs.formats.geometry.up_direction import up_of
from decogs.rig.numerics import floats
from decogs.rig.parallel import Each, side_by_side

from .agreement import Candidates, agree, no_candidates
from .cloud import (
    Cloud,
    ViewDepths,
    empty_cloud,
    join,
    look_from_all,
    neighbour_distances,
    shown_in,
    spread_to_count,
    take,
    thin_candidates,
    too_near,
)
from .frusta import (
    DepthRange,
    choose_neighbours,
    depths_of,
    likely_points,
    median_angle,
    points_within,
    rig_size,
    shared_depths,
)
from .guesses import guess_points
from .plane_sweep import DepthMap, choose_planes, sweep
from .views import Array, SweepView, inside, make_view, project

__all__ = ["FirstPoints", "KnownPoints", "first_points", "first_points_memory", "take_points"]

_FINE_PIXELS, _ALL_FINE_PIXELS = 250_000, 2_000_000
_COARSE_PIXELS = 14_000
"""Largest pictures of the sweeps, in pixels: one view's, all views' together, one view's in the coarse sweep."""
_MAX_PLANES = 128
_VIEW_BYTES, _PLANE_BYTES = 100, 6
"""Of a pixel of the fine sweep: its view, depths and candidates; the costs of a plane, along rows and columns."""
_WIDE_DEGREES = 20.0
"""Angle to the nearest matched neighbour from which level planes are swept, too. Below, facing ones match better."""
_MAX_LEVEL_SHARE = 0.2
"""Share of pixels that planes facing the views confirm in the coarse sweep, below which level ones are swept at all:
six or eight cameras around a room have .1 to .19 and gain 3 dB, 28 of a dome have .48 and would lose up to .3."""
_MATCHED_NEIGHBOURS, _COMPARED_NEIGHBOURS = 4, 8
"""Neighbours for matching, and for checking the consistency of depths."""
_CANDIDATES_PER_POINT = 3.0
"""Candidates per point of the cap from which points are chosen."""
_CONFIRMED_FRACTION = 0.85
"""Share of the room that confirmed points may take at first; the rest is for guesses."""
_COARSE_CONFIDENCE = 0.5
"""Confidence in points of the coarse sweep alone, relative to those of the fine one."""
_MIN_CONFIRMED_POINTS = 100
"""Least confirmed points of a view for its nearest depth to count."""
_HOUSING_DEPTH_FRACTION = 0.5
"""Share of a view's nearest confirmed depth below which other views' points count as its camera's housing."""


class KnownPoints(Protocol):
    """Points from elsewhere: ``xyz`` (P, 3) world, ``rgb`` (P, 3) uint8."""

    @property
    def xyz(self) -> NDArray[np.float32]:
        """Positions (P, 3) in world units."""
        ...

    @property
    def rgb(self) -> NDArray[np.uint8]:
        """Colours (P, 3) uint8, display-referred."""
        ...


@dataclass(frozen=True)
class FirstPoints:
    """The initial points of training.

    ``xyz`` (P, 3) world; ``rgb`` (P, 3) 0..1; ``spacing`` (P,) world units, the size one point has to cover (mean
    distance to its three nearest, within bounds); ``confidence`` (P,) 0..1, 0.05 for a guess. ``seen`` (V, P): the
    views in which the surface was confirmed where the point lies. ``placed`` (P,): whether the place is known: a view
    confirms it, or a confirmed plane goes on there.
    """

    xyz: NDArray[np.float32]
    rgb: NDArray[np.float32]
    spacing: NDArray[np.float32]
    confidence: NDArray[np.float32]
    seen: NDArray[np.bool_]
    placed: NDArray[np.bool_]


def take_points(points: FirstPoints, which: NDArray[np.bool_]) -> FirstPoints:
    """The points of ``which`` (P,)."""
    return FirstPoints(
        points.xyz[which],
        points.rgb[which],
        points.spacing[which],
        points.confidence[which],
        points.seen[:, which],
        points.placed[which],
    )


def first_points_memory(cameras: Sequence[Camera], threads: int) -> int:
    """Bytes that the search takes at most, beyond the pictures: its own ones, and a sweep's costs for each thread."""
    scales = _scales(cameras, _FINE_PIXELS, _ALL_FINE_PIXELS)
    pixels = [camera.width * camera.height * scale**2 for camera, scale in zip(cameras, scales, strict=True)]
    return round(sum(pixels) * _VIEW_BYTES + min(threads, len(cameras)) * max(pixels) * _MAX_PLANES * _PLANE_BYTES)


def first_points(
    cameras: Sequence[Camera],
    pictures: Sequence[NDArray[np.float32]],
    *,
    recorded: Sequence[NDArray[np.bool_] | None] = (),
    given: KnownPoints | None = None,
    cap: int,
    within: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
    seed: int = 0,
    threads: int = 0,
) -> FirstPoints:
    """At most ``cap`` coloured points on the surfaces the training views see, spread evenly over the pictures.

    ``cameras``: pinhole; ``pictures``: (H, W, 3) RGB 0..1 of the same cameras, and their pixels that were ``recorded``,
    (H, W), where that is not all; ``given``: points to use as well.
    ``within``: which points (P, 3) may be ones; then nothing is guessed beside them. The
    result depends on ``seed`` (guesses where views stay empty), not on ``threads`` (0: all cores). Cameras whose views
    share nothing give guesses only. Raises TrainingError if there are neither known points nor two cameras in two
    places, or if arguments do not fit together.
    """
    if len(cameras) != len(pictures) or cap < 1:
        raise TrainingError(f"first points: {len(pictures)} pictures for {len(cameras)} cameras, room for {cap} points")
    for camera, picture in zip(cameras, pictures, strict=True):
        if picture.shape != (camera.height, camera.width, 3):
            size = f"{camera.width}x{camera.height}"
            raise TrainingError(f"{camera.name}: a picture of shape {picture.shape} for a camera of {size} pixels")
        if camera.distortion_model != "none":
            raise TrainingError(f"{camera.name}: first points need undistorted pictures and a pinhole camera")
    with side_by_side(threads) as each:
        recorded = recorded or [None] * len(cameras)
        return _first_points(cameras, pictures, recorded, given, cap, within, np.random.default_rng(seed), each)


def _first_points(
    cameras: Sequence[Camera],
    pictures: Sequence[Array],
    recorded: Sequence[NDArray[np.bool_] | None],
    given: KnownPoints | None,
    cap: int,
    within: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None,
    random: np.random.Generator,
    each: Each,
) -> FirstPoints:
    coarse = list(each(make_view, cameras, pictures, _scales(cameras, _COARSE_PIXELS, np.inf), recorded))
    fine = list(each(make_view, cameras, pictures, _scales(cameras, _FINE_PIXELS, _ALL_FINE_PIXELS), recorded))
    given_cloud = _given_cloud(given, fine)
    if rig_size(fine) <= 0 and not len(given_cloud):
        raise TrainingError(
            "training cameras in one place give no depth: use cameras in two places, or a rig with known points"
        )

    shared = shared_depths(coarse)
    samples = [points_within(view, depths) for view, depths in zip(coarse, shared, strict=True)]
    rough, _ = _sweep_all(each, coarse, shared, samples, levels=False)
    levels = float(np.mean([len(c) / view.pixels for c, view in zip(rough, coarse, strict=True)])) < _MAX_LEVEL_SHARE
    if levels:
        rough, _ = _sweep_all(each, coarse, shared, samples, levels=True)
    everything = np.concatenate([*(c.xyz for c in rough), given_cloud.xyz])
    ranges = [depths_of(view, c.xyz, everything, at) for view, c, at in zip(fine, rough, shared, strict=True)]
    samples = [likely_points(view, everything, depths) for view, depths in zip(fine, ranges, strict=True)]
    candidates, maps = _sweep_all(each, fine, ranges, samples, levels=levels)
    all_depths = [_view_depths(*all_of_view) for all_of_view in zip(fine, ranges, candidates, maps, strict=True)]

    stride = max(1, int((sum(len(c) for c in candidates) / (_CANDIDATES_PER_POINT * cap)) ** 0.5))
    clouds = [given_cloud, *(thin_candidates(c, stride) for c in candidates)]
    clouds += [_where_unconfirmed(*three) for three in zip(coarse, rough, all_depths, strict=True)]
    proposed = join(clouds)
    proposed = take(proposed, ~too_near(proposed, all_depths, _HOUSING_DEPTH_FRACTION))
    if within is not None:
        cloud, pixels = _choose(take(proposed, within(proposed.xyz)), all_depths, cap)
        return _finish(cloud, np.zeros(len(cloud), np.bool_), pixels, all_depths)

    most = max(1, round(cap * _CONFIRMED_FRACTION))
    cloud, pixels = _choose(proposed, all_depths, most)
    filling, continued = guess_points(cloud, all_depths, pixels, random)
    if cap - len(filling) > most and len(cloud) < len(proposed):
        cloud, pixels = _choose(proposed, all_depths, cap - len(filling))
    room = cap - len(cloud)
    if len(filling) > room:
        kept = np.sort(random.permutation(len(filling))[:room])
        filling, continued = take(filling, kept), continued[kept]
    placed = np.concatenate([np.zeros(len(cloud), np.bool_), continued])
    return _finish(join([cloud, filling]), placed, pixels, all_depths)


def _scales(cameras: Sequence[Camera], each: float, together: float) -> list[float]:
    """Resolutions at which no picture has more than ``each`` pixels and all of them not more than ``together``."""
    total = sum(camera.width * camera.height for camera in cameras)
    return [min(1.0, (each / (c.width * c.height)) ** 0.5, (together / total) ** 0.5) for c in cameras]


def _sweep_all(
    each: Each,
    views: Sequence[SweepView],
    ranges: Sequence[DepthRange | None],
    samples: Sequence[NDArray[np.float64]],
    *,
    levels: bool,
) -> tuple[list[Candidates], list[DepthMap | None]]:
    """Every view's candidates and depth map; no candidates and None for views without shared depths.

    ``levels``: sweep level planes, too, in views whose neighbours are far apart.
    """
    neighbours = choose_neighbours(views, samples, _COMPARED_NEIGHBOURS)
    up = up_of([view.camera for view in views])

    def depth_map(i: int) -> DepthMap | None:
        depths, matched = ranges[i], [views[j] for j in neighbours[i][:_MATCHED_NEIGHBOURS]]
        if depths is None or not matched:
            return None
        beside = min(median_angle(samples[i], views[i], other) for other in matched)
        planes = choose_planes(views[i], matched, depths, _MAX_PLANES)
        return sweep(views[i], matched, planes, up if levels and beside > _WIDE_DEGREES else None)

    def candidates(i: int) -> Candidates:
        own = maps[i]
        return (
            no_candidates()
            if own is None
            else agree(views, i, neighbours[i], neighbours[i][:_MATCHED_NEIGHBOURS], own, maps)
        )

    maps = list(each(depth_map, range(len(views))))
    return list(each(candidates, range(len(views)))), maps


def _view_depths(
    view: SweepView, depths: DepthRange | None, candidates: Candidates, depth_map: DepthMap | None
) -> ViewDepths:
    """Result of the fine sweep for one view."""
    if depth_map is None:
        return ViewDepths(view, depths, None, None, 0.0)
    confirmed = np.zeros((view.height, view.width), np.float32)
    confirmed[candidates.row, candidates.column] = candidates.inverse_depth
    nearest = (
        1 / float(np.percentile(candidates.inverse_depth, 99.9)) if len(candidates) >= _MIN_CONFIRMED_POINTS else 0.0
    )
    return ViewDepths(view, depths, depth_map.inverse_depth, confirmed, nearest)


def _given_cloud(given: KnownPoints | None, views: Sequence[SweepView]) -> Cloud:
    """The given points as a cloud; their spacing is a pixel of the nearest view that sees them."""
    if given is None or not len(given.xyz):
        return empty_cloud()
    xyz = np.asarray(given.xyz, np.float64)
    spacing = np.full(len(xyz), np.inf)
    for view in views:
        u, v, depth = project(view, xyz)
        seen = inside(view, u, v) & (depth > 0)
        spacing[seen] = np.minimum(spacing[seen], depth[seen] / view.focal)
    rgb = floats(given.rgb) / np.float32(255)
    cloud = Cloud(xyz, rgb, floats(spacing), np.ones(len(xyz), np.float32))
    return take(cloud, np.isfinite(spacing) & np.isfinite(xyz).all(axis=1))


def _where_unconfirmed(coarse: SweepView, candidates: Candidates, view_depths: ViewDepths) -> Cloud:
    """Points of the coarse sweep where the fine one confirms none: little texture, very different views."""
    cloud = thin_candidates(candidates, 1)
    cloud = replace(cloud, confidence=np.float32(_COARSE_CONFIDENCE) * cloud.confidence)
    if view_depths.confirmed is None:
        return cloud
    view = view_depths.view
    reach = 2 * round(view.width / coarse.width) + 1
    covered = cv2.dilate((view_depths.confirmed > 0).astype(np.uint8), np.ones((reach, reach), np.uint8))
    u, v, _ = project(view, cloud.xyz)
    column = np.clip(np.round(u), 0, view.width - 1).astype(np.int64)
    row = np.clip(np.round(v), 0, view.height - 1).astype(np.int64)
    return take(cloud, covered[row, column] == 0)


def _choose(proposed: Cloud, all_depths: Sequence[ViewDepths], most: int) -> tuple[Cloud, float]:
    """At most ``most`` evenly spread points without floaters, coloured by all views, and their spacing in pixels."""
    cloud, pixels = spread_to_count(proposed, most)
    sight = look_from_all(cloud, all_depths)
    return take(replace(cloud, rgb=sight.rgb), (sight.through <= 1) | (2 * sight.through <= sight.in_place)), pixels


def _finish(cloud: Cloud, continued: NDArray[np.bool_], pixels: float, all_depths: Sequence[ViewDepths]) -> FirstPoints:
    seen = np.stack([shown_in(view_depths, cloud.xyz) for view_depths in all_depths])
    usual = cloud.spacing * np.float32(pixels)
    return FirstPoints(
        xyz=cloud.xyz.astype(np.float32),
        rgb=np.clip(cloud.rgb, 0, 1).astype(np.float32),
        spacing=np.clip(neighbour_distances(cloud.xyz), np.float32(0.5) * usual, 3 * usual),
        confidence=cloud.confidence,
        seen=seen,
        placed=seen.any(axis=0) | continued,
    )
