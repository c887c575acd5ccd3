"""The backdrop's surfaces, found from its shading alone: a floor, and a wall around it that is closed above.

Views that look at one point of a plain surface agree about its colour, those that look at two points of it do not, as
long as light falls on it unevenly. So the floor lies at the height at which plain pixels agree best, and the wall, an
upright cylinder, at such a radius. Light that falls evenly leaves both open. A far sphere shows that as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.subject.hull import BoolArray
from decogs.formats.cameras import Camera, camera_centre, in_picture, project, turned
from decogs.formats.geometry.axes import point_nearest_axes
from decogs.formats.splats import FloatArray

from ..numerics import floats

F64 = NDArray[np.float64]

_SAMPLES = 2500
"""Points of a surface in the search."""
_MIN_VIEWS = 3
"""Views that must look at a point for their agreement to count."""
_MAX_DISAGREEMENT_LEVELS = 25.0
"""Disagreement that counts at most: pixels that show something else."""
_FLOOR_STEPS, _WALL_STEPS, _FINE_STEPS = 60, 32, 13
_FLOOR_RANGE = (0.02, 2.0)
"""Nearest and farthest floor below the middle of what the cameras look at, in units of their distance."""
_WALL_RANGE = (0.6, 4.0)
"""Nearest and farthest wall, in units of the cameras' distance."""
_MIN_SHARPNESS = 1.4
"""Least ratio of the usual disagreement of heights to that of the floor's."""
_MIN_TEXTURE_SHARPNESS = 1.2
"""Least ratio of the disagreement of heights nearby to that of a floor with texture."""
_NEARBY_STEPS = 3
"""Heights above and below with which that of a floor with texture is compared."""
_MIN_FLOOR_SHARE = 0.5
"""Least share of the floor that enough views see."""
_SPHERE_DISTANCES = 2.0
"""Radius of the sphere, in units of the cameras' distance."""


@dataclass(frozen=True)
class PlainView:
    """A view's camera, the pixels (H, W) that show the backdrop, and its plate (H, W, 3)."""

    camera: Camera
    plain: BoolArray
    plate: FloatArray


@dataclass(frozen=True)
class Surfaces:
    """A floor and a wall around an upright axis through ``middle`` (3,), or a sphere around it where ``floor`` is None.

    ``axes`` (3, 3): two horizontal directions and the one upwards, as rows. ``floor``: its height over the middle,
    negative. ``radius``: of wall, and height of its lid over the middle; or of the sphere.
    """

    middle: F64
    axes: F64
    floor: float | None
    radius: float

    def clearance(self, xyz: NDArray[np.floating]) -> F64:
        """Distance (P,) of points (P, 3) from the surfaces, negative beyond them."""
        local = turned(self.axes, xyz - self.middle)
        if self.floor is None:
            return np.asarray(self.radius - np.linalg.norm(local, axis=1))
        wall = self.radius - np.hypot(local[:, 0], local[:, 1])
        return np.asarray(np.minimum(np.minimum(wall, local[:, 2] - self.floor), self.radius - local[:, 2]))

    def gaps(self, centres: F64) -> tuple[F64, NDArray[np.int64]]:
        """Angles between neighbouring places (C, 3) around the axis, degrees, (C,), and the places in that order."""
        local = turned(self.axes, centres - self.middle)
        around = np.degrees(np.arctan2(local[:, 1], local[:, 0]))
        order = np.argsort(around, kind="stable")
        return np.diff(around[order], append=around[order[0]] + 360), order

    def points(self, spacing: float) -> tuple[F64, F64]:
        """Points (P, 3) spread over all surfaces at this distance, and the normals there (P, 3), inwards."""
        if self.floor is None:
            return self._world(*_sphere(self.radius, spacing))
        height = self.radius - self.floor
        parts = [_disc(self.radius, self.floor, 1.0, spacing), _disc(self.radius, self.radius, -1.0, spacing)]
        parts.append(_wall(self.radius, self.floor, height, spacing))
        return self._world(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    @property
    def area(self) -> float:
        """Of all surfaces, in square world units."""
        if self.floor is None:
            return 4 * np.pi * self.radius**2
        return 2 * np.pi * self.radius * (self.radius + self.radius - self.floor)

    def _world(self, local: F64, normals: F64) -> tuple[F64, F64]:
        return turned(self.axes.T, local) + self.middle, turned(self.axes.T, normals)


def _disc(radius: float, height: float, up: float, spacing: float) -> tuple[F64, F64]:
    """A disc of hexagonally packed points."""
    count = int(np.ceil(radius / spacing)) + 1
    row, column = np.mgrid[-2 * count : 2 * count + 1, -2 * count : 2 * count + 1].reshape(2, -1)
    x, y = spacing * (column + 0.5 * (row % 2)), spacing * np.sqrt(0.75) * row
    kept = np.hypot(x, y) <= radius
    flat = np.stack([x[kept], y[kept], np.full(kept.sum(), height)], axis=1)
    return flat, np.broadcast_to([0.0, 0.0, up], flat.shape)


def _wall(radius: float, floor: float, height: float, spacing: float) -> tuple[F64, F64]:
    around, rows = max(8, round(2 * np.pi * radius / spacing)), max(2, round(height / (spacing * np.sqrt(0.75))))
    row, column = np.mgrid[:rows, :around].reshape(2, -1)
    angle = 2 * np.pi * (column + 0.5 * (row % 2)) / around
    outwards = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
    points = radius * outwards
    points[:, 2] = floor + height * (row + 0.5) / rows
    return points, -outwards


def _sphere(radius: float, spacing: float) -> tuple[F64, F64]:
    """A sphere of points along a golden spiral."""
    count = max(16, round(4 * np.pi * (radius / spacing) ** 2))
    number = np.arange(count)
    height = 1 - (2 * number + 1) / count
    angle, ring = np.pi * (1 + 5**0.5) * number, np.sqrt(1 - height**2)
    outwards = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=1)
    return radius * outwards, -outwards


def find_surfaces(views: Sequence[PlainView]) -> Surfaces:
    """The floor and the wall on which plain pixels of all views agree best, or a far sphere."""
    centres, middle, distance = _around(views)
    best: tuple[float, Surfaces] | None = None
    for up in _upward(views, centres):
        axes = _axes(up)
        search = _Search(views, middle, axes, distance)
        floor = search.floor(float(((centres - middle) @ up).min()))
        if floor is not None and (best is None or floor[0] < best[0]):
            best = floor[0], Surfaces(middle, axes, floor[1], search.wall(floor[1]))
    return best[1] if best else Surfaces(middle, np.eye(3), None, _SPHERE_DISTANCES * distance)


def find_room(walls: Sequence[PlainView], whole: Sequence[PlainView]) -> Surfaces | None:
    """The wall on which plain pixels agree, around a floor on which the ``whole`` pictures do; None unless both do."""
    centres, middle, distance = _around(walls)
    for up in _upward(walls, centres):
        axes = _axes(up)
        floor = _Search(whole, middle, axes, distance).textured_floor(float(((centres - middle) @ up).min()))
        wall = None if floor is None else _Search(walls, middle, axes, distance).best_wall(floor)
        if floor is not None and wall is not None and wall[2] >= _MIN_SHARPNESS:
            return Surfaces(middle, axes, floor, wall[1])
    return None


def _around(views: Sequence[PlainView]) -> tuple[F64, F64, float]:
    """The cameras' centres (V, 3), the middle of what they look at (3,), and how far they usually are from it."""
    centres = np.array([camera_centre(view.camera) for view in views])
    middle, _ = point_nearest_axes([view.camera for view in views])
    return centres, middle, float(np.median(np.linalg.norm(centres - middle, axis=1)))


def _upward(views: Sequence[PlainView], centres: F64) -> list[F64]:
    """Directions that may be upwards: that of the pictures, and across the ring of cameras."""
    pictures = -np.mean([view.camera.world_to_camera[1, :3] for view in views], axis=0)
    length = float(np.linalg.norm(pictures))
    upward = [pictures / length] if length > 0.3 else []
    _, _, directions = np.linalg.svd(centres - centres.mean(axis=0))
    ring = directions[2]
    across = [ring, -ring] if not upward else [ring * np.sign(ring @ upward[0] or 1.0)]
    return [*upward, *across]


def _axes(up: F64) -> F64:
    other = np.eye(3)[np.argmin(np.abs(up))]
    x = np.cross(other, up)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


class _Search:
    def __init__(self, views: Sequence[PlainView], middle: F64, axes: F64, distance: float) -> None:
        self._views, self._middle, self._axes, self._distance = views, middle, axes, distance
        values = turned(axes, np.array([camera_centre(view.camera) for view in views]) - middle)
        self._outermost = float(max(np.hypot(values[:, 0], values[:, 1]).max(), values[:, 2].max()))
        """Radius of the wall and its lid that just hold all cameras."""

    def floor(self, lowest_camera: float) -> tuple[float, float] | None:
        """Disagreement and height of the floor, which is below all cameras; None where no height is better."""
        heights, disc, normals = self._heights(lowest_camera)

        def cost(height: float) -> float:
            return self._disagreement(disc + np.array([0, 0, height]), normals)

        best = _minimum(cost, heights)
        if best is None or best[2] < _MIN_SHARPNESS:
            return None
        return best[0], best[1]

    def textured_floor(self, lowest_camera: float) -> float | None:
        """Height of a floor with texture; None where the colours of no height agree better than those nearby."""
        heights, disc, normals = self._heights(lowest_camera)

        def costs_at(values: F64) -> F64:
            return np.array([self._median_disagreement(disc + np.array([0, 0, each]), normals) for each in values])

        costs, reach = costs_at(heights), _NEARBY_STEPS
        if len(costs) <= 2 * reach:
            return None
        around = [np.delete(costs[at - reach : at + reach + 1], reach) for at in range(reach, len(costs) - reach)]
        nearby = np.median(around, axis=1)
        finite = np.isfinite(nearby)
        sharpness = np.divide(nearby, costs[reach:-reach], out=np.zeros_like(nearby), where=finite)
        at = int(np.argmax(sharpness))
        fine = np.linspace(heights[at + reach - 1], heights[at + reach + 1], _FINE_STEPS)
        finer = costs_at(fine)
        if not finite[at] or nearby[at] < _MIN_TEXTURE_SHARPNESS * finer.min():
            return None
        return float(fine[int(np.argmin(finer))])

    def _heights(self, lowest_camera: float) -> tuple[F64, F64, F64]:
        """Heights a floor may have, below all cameras, and points of one (P, 3), with normals."""
        near, far = (share * self._distance for share in _FLOOR_RANGE)
        heights = -np.geomspace(near, far, _FLOOR_STEPS)
        disc, normals = _disc(self._distance, 0.0, 1.0, self._distance * np.sqrt(np.pi / _SAMPLES))
        return heights[heights < lowest_camera], disc, normals

    def wall(self, floor: float) -> float:
        """Radius of the wall, which is behind all cameras: one before them would stand between them and the scene."""
        best = self.best_wall(floor)
        return (
            best[1]
            if best
            else max(_SPHERE_DISTANCES * self._distance, _WALL_RANGE[0] * self._distance, self._outermost)
        )

    def best_wall(self, floor: float) -> tuple[float, float, float] | None:
        """Disagreement and radius of the wall, and how much more the usual radius has."""
        nearest, far = (share * self._distance for share in _WALL_RANGE)
        near = max(nearest, self._outermost)
        far = max(far, near)

        def cost(radius: float) -> float:
            height = 0.7 * radius - floor
            return self._disagreement(*_wall(radius, floor, height, np.sqrt(2 * np.pi * radius * height / _SAMPLES)))

        return _minimum(cost, np.geomspace(near, far, _WALL_STEPS))

    def _disagreement(self, local: F64, normals: F64) -> float:
        """Mean over points of the deviation of their plain colours between views, in 8-bit levels."""
        xyz, normals = turned(self._axes.T, local) + self._middle, turned(self._axes.T, normals)
        counts, total, squares = np.zeros(len(xyz)), np.zeros((len(xyz), 3)), np.zeros((len(xyz), 3))
        for view in self._views:
            rows, colours = plain_colours(view, xyz, normals)
            counts[rows] += 1
            total[rows] += colours
            squares[rows] += colours**2
        enough = counts >= _MIN_VIEWS
        if enough.sum() < 0.05 * len(xyz):
            return np.inf
        n = counts[enough, None]
        deviation = np.sqrt(
            np.maximum(squares[enough] / n - (total[enough] / n) ** 2, 0).mean(axis=1) * n[:, 0] / (n[:, 0] - 1)
        )
        return float(np.minimum(255 * deviation, _MAX_DISAGREEMENT_LEVELS).mean())

    def _median_disagreement(self, local: F64, normals: F64) -> float:
        """Mean over points of the median deviation of their colours from the median view's, in 8-bit levels.

        What stands on a floor hides each of its points from a few views, which this leaves out.
        """
        xyz, normals = turned(self._axes.T, local) + self._middle, turned(self._axes.T, normals)
        colours = np.full((len(self._views), len(xyz), 3), np.nan, np.float32)
        for view, row in zip(self._views, colours, strict=True):
            rows, shown = plain_colours(view, xyz, normals)
            row[rows] = shown
        enough = (~np.isnan(colours[..., 0])).sum(axis=0) >= _MIN_VIEWS
        if enough.mean() < _MIN_FLOOR_SHARE:
            return np.inf
        colours = colours[:, enough]
        deviation = np.nanmedian(np.abs(colours - np.nanmedian(colours, axis=0)), axis=0)
        return float(255 * deviation.mean())


def plain_colours(view: PlainView, xyz: F64, normals: F64) -> tuple[NDArray[np.int64], FloatArray]:
    """Rows of the points whose front a view shows as plain, and their colours there (R, 3)."""
    u, v, depth = project(view.camera, xyz)
    facing = (normals * (camera_centre(view.camera) - xyz)).sum(axis=1) > 0
    rows = np.flatnonzero(in_picture(view.camera, u, v, depth) & facing)
    column, row = u[rows].astype(np.int64), v[rows].astype(np.int64)
    plain = view.plain[row, column]
    return rows[plain], view.plate[row[plain], column[plain]]


def _minimum(cost: Callable[[float], float], values: F64) -> tuple[float, float, float] | None:
    """Least cost, its place, and how much less it is than the usual one; None without a finite cost."""
    costs = np.array([cost(value) for value in values])
    if not np.isfinite(costs).any():
        return None
    at = int(np.argmin(costs))
    usual = float(np.median(costs[np.isfinite(costs)]))
    fine = np.linspace(values[max(at - 1, 0)], values[min(at + 1, len(values) - 1)], _FINE_STEPS)
    finer = np.array([cost(value) for value in fine])
    finest = int(np.argmin(finer))
    return float(finer[finest]), float(fine[finest]), usual / max(float(finer[finest]), 1e-9)


def surface_colours(views: Sequence[PlainView], xyz: F64, normals: F64) -> FloatArray:
    """Mean plain colours (P, 3) that views show of points, those of the nearest known one where no view shows any."""
    total, counts = np.zeros((len(xyz), 3), np.float32), np.zeros(len(xyz), np.float32)
    for view in views:
        rows, colours = plain_colours(view, xyz, normals)
        total[rows] += colours
        counts[rows] += 1
    seen = counts > 0
    mean = total / np.maximum(counts, np.float32(1))[:, None]
    if not seen.all() and seen.any():
        mean[~seen] = mean[seen][nearest_of(xyz[seen], xyz[~seen])]
    return floats(mean)


def nearest_of(points: F64, values: F64) -> NDArray[np.int64]:
    """Rows of the nearest of ``points`` (P, D) to each of ``values`` (Q, D)."""
    tree = cv2.flann.Index(points.astype(np.float32), {"algorithm": 4, "leaf_max_size": 10})
    rows, _ = tree.knnSearch(values.astype(np.float32), 1, params={"checks": -1})
    return np.asarray(rows[:, 0], np.int64)
