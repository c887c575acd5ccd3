"""Depth of one view by plane sweep: photo-consistency on planes, semi-global aggregation, sub-plane depth.

Planes face the camera. Where the other views stand far to the side, they see a floor under another angle, and no such
plane matches it; then level planes are swept, too, and the cheaper depth is a pixel's.

Sources: plane sweep after Collins (1996) with planes evenly spaced in inverse depth; level planes after Gallup (2007),
"Real-time plane-sweeping stereo with multiple sweeping directions"; aggregation after Hirschmüller (2008), "Stereo
processing by semi-global matching and mutual information", with four path directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.rig.numerics import floats

from .frusta import DepthRange, ray_grid
from .views import Array, SweepView, between, project

_MAX_DIFFERENCE = 1.5
"""Difference of normalised luminance from which on two pixels are just different."""
_COST_SCALE = 255.0 / (2 * _MAX_DIFFERENCE)
_OUTSIDE_VALUE = -100.0
_SMALL_JUMP_COST = 10
_LARGE_JUMP_COST = 60
"""Costs of a depth step between neighbouring pixels by one plane, and by more (cost of one pixel: 0..255)."""
_PIXELS_PER_PLANE = 1.25
_FACING = np.array([0.0, 0.0, 1.0])
"""Slope of planes that face the camera: a plane's inverse depth at pixel (u, v, 1), first centre at 0, in its own."""
_MIN_FLOOR_SHARE = 0.1
"""Least share of a picture below the horizon for level planes to be swept."""
_LEVEL = 1e-3
"""Slope of a level plane up to which a pixel is at the horizon: depth there is hardly determined."""


@dataclass(frozen=True)
class DepthMap:
    """``inverse_depth`` (H, W) float32, 1 / world units along the optical axis."""

    inverse_depth: Array


@dataclass(frozen=True)
class Costs:
    """Costs of every depth for every pixel: ``upright`` (H, D, W) and the same ``turned`` (W, D, H), uint8."""

    upright: NDArray[np.uint8]
    turned: NDArray[np.uint8]


def choose_planes(view: SweepView, neighbours: Sequence[SweepView], depths: DepthRange, most: int) -> Array:
    """Inverse depths of the planes, ascending, so that a picture moves about one pixel from plane to plane."""
    rays = ray_grid(view)
    moves = []
    for other in neighbours:
        u0, v0, z0 = project(other, view.centre + rays * depths.far)
        u1, v1, z1 = project(other, view.centre + rays * depths.near)
        move = np.hypot(u1 - u0, v1 - v0)[(z0 > 0) & (z1 > 0)]
        moves.append(float(np.median(move)) if move.size else 0.0)
    count = int(np.clip(np.ceil(float(np.median(moves)) / _PIXELS_PER_PLANE) + 1, 8, most))
    return np.linspace(1 / depths.far, 1 / depths.near, count, dtype=np.float32)


def _behind(homography: NDArray[np.float64], width: int, height: int) -> NDArray[np.bool_] | None:
    """Pixels whose point on the plane lies behind the other camera; None if there are none."""
    a, b, c = homography[2]
    corners = [c, a * (width - 1) + c, b * (height - 1) + c, a * (width - 1) + b * (height - 1) + c]
    if min(corners) > 0:
        return None
    return np.asarray(a * np.arange(width) + b * np.arange(height)[:, None] + c <= 0)


def _recorded_alone(view: SweepView) -> Array:
    """The view's normalised picture, outside of what was recorded as outside of the picture."""
    if view.recorded is None:
        return view.normalised
    return np.where(view.recorded, view.normalised, np.float32(_OUTSIDE_VALUE))


def _better_half(costs: list[Array], looking: NDArray[np.uint8]) -> Array:
    """Twice the mean of the better half of up to four costs: points occluded in some neighbours show in others.

    ``looking`` (H, W): how many of the neighbours' pictures the points fall into; of one, its own cost counts alone.
    """
    if len(costs) == 1:
        return costs[0] * 2
    if len(costs) == 2:
        return floats(cv2.min(costs[0], costs[1])) * 2
    if len(costs) == 3:
        best = cv2.min(cv2.min(costs[0], costs[1]), costs[2])
        half = costs[0] + costs[1] + costs[2] - floats(cv2.max(cv2.max(costs[0], costs[1]), costs[2]))
    else:
        low0, high0 = cv2.min(costs[0], costs[1]), cv2.max(costs[0], costs[1])
        low1, high1 = cv2.min(costs[2], costs[3]), cv2.max(costs[2], costs[3])
        best = cv2.min(low0, low1)
        half = floats(cv2.add(best, cv2.min(cv2.max(low0, low1), cv2.min(high0, high1))))
    return np.where(looking == 1, 2 * floats(best), half)


def matching_costs(
    view: SweepView, neighbours: Sequence[SweepView], planes: Array, slope: NDArray[np.float64] = _FACING
) -> Costs:
    """Photo-consistency costs, 0 alike to 255 different or not seen, (H, D, W) and (W, D, H).

    Inverse depth at pixel (u, v, 1), first centre at 0, is the plane's times ``slope`` (3,) times the pixel.
    """
    size = (view.width, view.height)
    upright = np.empty((view.height, len(planes), view.width), np.uint8)
    turned = np.empty((view.width, len(planes), view.height), np.uint8)
    mappings = [between(view, other) for other in neighbours]
    seen = [_recorded_alone(other) for other in neighbours]
    for d, inverse_depth in enumerate(planes):
        per_view: list[Array] = []
        looking = np.zeros((view.height, view.width), np.uint8)
        for normalised, (matrix, offset) in zip(seen, mappings, strict=True):
            homography = matrix + np.outer(offset, float(inverse_depth) * slope)
            warped = cv2.warpPerspective(
                normalised,
                homography,
                size,
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_CONSTANT,
                borderValue=_OUTSIDE_VALUE,
            )
            hidden = _behind(homography, *size)
            if hidden is not None:
                warped[hidden] = _OUTSIDE_VALUE
            looking += warped > _OUTSIDE_VALUE / 2
            cv2.absdiff(warped, view.normalised, dst=warped)
            cv2.threshold(warped, _MAX_DIFFERENCE, 0, cv2.THRESH_TRUNC, dst=warped)
            per_view.append(floats(cv2.blur(warped, (3, 3))))
        cost = cv2.convertScaleAbs(_better_half(per_view, looking), alpha=_COST_SCALE)
        upright[:, d] = cost
        turned[:, d] = cv2.transpose(cost)
    return Costs(upright, turned)


def _aggregate_rows(costs: NDArray[np.uint8], jump: NDArray[np.int16], total: NDArray[np.int16]) -> None:
    """Adds to ``total`` the path costs down and up the first axis of ``costs`` (rows, planes, columns)."""
    rows, planes, columns = costs.shape
    padded = np.full((planes + 2, columns), 10_000, np.int16)
    path = padded[1:-1]
    best = np.empty((planes, columns), np.int16)
    for order in (range(rows), range(rows - 1, -1, -1)):
        previous = -1
        for y in order:
            if previous < 0:
                path[:] = costs[y]
            else:
                lowest = path.min(axis=0)
                np.minimum(padded[:-2], padded[2:], out=best)
                best += _SMALL_JUMP_COST
                np.minimum(best, path, out=best)
                np.minimum(best, lowest + jump[max(y, previous)], out=best)
                best -= lowest
                np.add(best, costs[y], out=path)
            total[y] += path
            previous = y


def aggregate(costs: Costs, luminance: Array) -> NDArray[np.int16]:
    """Semi-global sums of matching costs over four straight paths, (H, D, W); depth may jump where brightness does."""
    total = np.zeros(costs.upright.shape, np.int16)
    planes = costs.upright.shape[1]
    _aggregate_rows(costs.upright, _jump_costs(luminance), total)
    turned = np.zeros(costs.turned.shape, np.int16)
    _aggregate_rows(costs.turned, _jump_costs(np.ascontiguousarray(luminance.T)), turned)
    for d in range(planes):
        total[:, d] += np.asarray(cv2.transpose(turned[:, d]), np.int16)
    return total


def _jump_costs(luminance: Array) -> NDArray[np.int16]:
    step = np.abs(np.diff(luminance, axis=0, prepend=luminance[:1]))
    return np.maximum(_LARGE_JUMP_COST / (1 + 10 * step), _SMALL_JUMP_COST + 5).astype(np.int16)


def pick_depths(total: NDArray[np.int16], planes: Array) -> DepthMap:
    """Cheapest plane per pixel, refined by a parabola through its neighbours' costs."""
    best = total.argmin(axis=1)[:, None]
    middle = np.clip(best, 1, len(planes) - 2)
    here, below, above = (np.take_along_axis(total, middle + k, axis=1)[:, 0].astype(np.float32) for k in (0, -1, 1))
    curvature = below - 2 * here + above
    offset = np.where(curvature > 0, (below - above) / np.maximum(2 * curvature, 1), best[:, 0] - middle[:, 0])
    plane = middle[:, 0] + np.clip(offset, -1, 1)
    step = (planes[-1] - planes[0]) / (len(planes) - 1)
    return DepthMap(floats(planes[0] + plane * step))


def sweep(
    view: SweepView, neighbours: Sequence[SweepView], planes: Array, up: NDArray[np.float64] | None = None
) -> DepthMap:
    """Depth of every pixel of ``view``, matched with one to four neighbours; ``planes``: see ``choose_planes``.

    With ``up`` (3,), a world direction, level planes below the camera count as well, where they match better.
    """
    luminance = view.picture.mean(axis=2)
    total = aggregate(matching_costs(view, neighbours, planes), luminance)
    facing = pick_depths(total, planes)
    if up is None:
        return facing
    slope = -(view.rotation @ up) @ np.linalg.inv(view.intrinsics)
    slopes = slope[0] * np.arange(view.width) + slope[1] * np.arange(view.height)[:, None] + slope[2]
    below = slopes > _LEVEL
    if below.mean() < _MIN_FLOOR_SHARE:
        return facing
    steepest, usual = np.percentile(slopes[below], [95, 50])
    levels = np.linspace(planes[0] / steepest, planes[-1] / usual, len(planes), dtype=np.float32)
    cheapest = total.min(axis=1)
    total = aggregate(matching_costs(view, neighbours, levels, slope), luminance)
    floor = floats(pick_depths(total, levels).inverse_depth * slopes)
    return DepthMap(np.where(below & (total.min(axis=1) < cheapest), floor, facing.inverse_depth))
