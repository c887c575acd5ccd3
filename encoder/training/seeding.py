"""Seeds of new Gaussians for objects that appear in a later frame, from the pictures alone.

Moving and splitting the selected Gaussians cannot make an object that comes out of a box or into the scene. The search
runs after the selected Gaussians have had time to follow the pictures. It casts rays through the pixels that still
differ clearly, keeps the depths at which the residual masks of the other views agree (a visual hull), and puts a ray's
seed at the foremost depth at which the other views show the pixel's colour.

A wrong seed is a floater. So a seed must lie in front of the rendered surface, and that surface must not explain the
pixel itself: under a change of light all views still agree about the old surface.

Source: visual hull (Laurentini 1994) and photo hull (Kutulakos and Seitz 2000, "A theory of shape by space carving").
Rejected: a voxel grid (useful only at the resolution of pixels, and then mostly empty).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, in_camera, in_picture, ray_directions
from decogs.formats.splats import FloatArray, Splats, empty_splats, round_splats
from decogs.rig.numerics import bilinear
from decogs.rig.parallel import Each, side_by_side

from ..settings.frame import EmergenceSettings

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

_MISSED_LEVELS = 25.0
"""8-bit levels by which a rendering must miss the picture: fewer find fainter objects, and more wrong ones."""
_MIN_MISSED_SHARE = 2e-4
"""Share of all views' pixels that must be missed before a search begins."""
_RAY_DEPTHS = 64
"""Steps along a ray."""
_MIN_MISSING_VIEWS = 4
"""Views that must miss the same point."""
_MAX_NOT_MISSING_SHARE = 0.25
"""Share of the views that see the point and need not miss it."""
_MAX_SPREAD_LEVELS = 14.0
"""8-bit levels by which colours of one point may differ."""
_IN_FRONT_SHARE = 0.02
"""Share of the rendered depth by which a seed must lie before it."""
_SEED_OPACITY = 0.3
_NEAREST_DEPTH_SHARE = 0.6
"""Nearest depth searched, as a share of the first percentile of the rendered depths."""
_AGREEING_VIEWS_SHARE = 0.6
"""Share of the views that see a point whose colours must agree; the others may be occluded."""
_SAME_COST_SHARE = 0.1
"""Share of the allowed spread within which two depths of a ray explain it equally well; the nearer one wins."""
_CELL_RAY_SPACINGS = 4.0
"""Size of a neighbourhood, as a multiple of the distance between rays."""
_SIGMA_PER_SPACING = 0.6
_MIN_ALPHA = np.float32(1e-6)
"""Alpha of a ray that meets nothing: keeps its depth at 0."""
_BATCH_RAYS = 500
"""Rays per batch, at least, if there are as many: enough for numpy to dominate Python."""
_BLOCK_SIDE_PIXELS = 64
"""Side of a block of pixels that is smoothed at once."""
_MARGIN_PIXELS = 2
"""Pixels right and below of a position that its value may be read from: positions are rounded to parts of a pixel."""


@dataclass(frozen=True)
class SearchView:
    """One view at the time of the search: its pinhole camera, picture and rendering (3, H, W), alpha and depth (H, W).

    The depth is summed with the rendering weights, in world units. ``focus`` (H, W): the region in which the frame may
    change. ``recorded`` (H, W): where the picture was, None meaning everywhere.
    """

    camera: Camera
    picture: FloatArray
    rendered: FloatArray
    alpha: FloatArray
    depth: FloatArray
    focus: BoolArray
    recorded: BoolArray | None = None

    @cached_property
    def missed(self) -> FloatArray:
        """By how much the rendering misses a pixel of the focus, (H, W), in its worst colour; 0 elsewhere."""
        missed = np.zeros(self.focus.shape, np.float32)
        for rendered, picture in zip(self.rendered, self.picture, strict=True):
            cv2.max(missed, cv2.absdiff(rendered, picture), dst=missed)
        missed[~self.focus] = 0
        return missed

    def surface(self, pixels: IntArray | slice) -> FloatArray:
        """Mean depth along the rays of flat pixels, 0 for none."""
        return np.asarray(self.depth.ravel()[pixels] / np.maximum(self.alpha.ravel()[pixels], _MIN_ALPHA))


def missed_pixels(view: SearchView, levels: float = _MISSED_LEVELS) -> BoolArray:
    """Pixels (H, W) of the focus where rendering and picture clearly differ, without edges one pixel wide."""
    wrong = view.missed > np.float32(levels / 255)
    return cv2.morphologyEx(wrong.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).view(np.bool_)


def enough_missed_pixels(masks: Sequence[BoolArray]) -> bool:
    """Whether ``masks`` of missed pixels cover more than a tiny share of their pictures."""
    missing = sum(map(np.count_nonzero, masks))
    return missing > _MIN_MISSED_SHARE * sum(mask.size for mask in masks)


def find_seeds(
    views: Sequence[SearchView],
    cores: Sequence[BoolArray],
    settings: EmergenceSettings,
    sh_degree: int,
    *,
    threads: int = 1,
) -> Splats:
    """New Gaussians where the views agree on a surface in front of the rendered one; often none.

    ``views``: all training views; ``cores``: their `missed_pixels`; ``sh_degree``: the scene's. Deterministic.
    """
    if settings.max_seeds <= 0 or not enough_missed_pixels(cores):
        return empty_splats(sh_degree)
    step = max(1, -(-sum(map(np.count_nonzero, cores)) // settings.max_rays))
    with side_by_side(threads) as each:
        search = _Search(views, cores, each)
        seeds = list(each(search.along_rays, search.rays(step, each)))
    if not seeds:
        return empty_splats(sh_degree)
    return _splats(_thin(_confirm(_join(seeds), step), settings.max_seeds), cores, sh_degree)


@dataclass(frozen=True)
class _Rays:
    """Rays through pixels (flat indices) of several views: origin and direction (R, 3), of depth 1.

    ``surface`` (R,): the rendered depth, 0 for none. ``colours`` (R, 3): as recorded; ``smooth``: around the pixel.
    """

    views: IntArray
    pixels: IntArray
    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    surface: FloatArray
    colours: FloatArray
    smooth: FloatArray


@dataclass(frozen=True)
class _Seeds:
    """Points (P, 3) float64, the views of their rays, colours (P, 3), size of a pixel there, disagreement (P,)."""

    points: NDArray[np.float64]
    views: IntArray
    colours: FloatArray
    pixel: NDArray[np.float64]
    cost: FloatArray


P = TypeVar("P", _Rays, _Seeds)


def _join(parts: Sequence[P]) -> P:
    columns = [np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(parts[0])]
    return type(parts[0])(*columns)


def _take(part: P, rows: IntArray | slice) -> P:
    return type(part)(*(getattr(part, field.name)[rows] for field in fields(part)))


class _Smoothed:
    """A picture (H, W, 3) averaged over 3 x 3 pixels, block by block on demand.

    The search reads few pixels of many large pictures. ``planes`` (3, h, w) are given for a range of rows and of
    columns. Threads may ask at the same time: a block that two of them make is the same twice.
    """

    def __init__(self, camera: Camera, planes: Callable[[slice, slice], FloatArray]) -> None:
        self._planes, self._height, self._width = planes, camera.height, camera.width
        self._bands: dict[int, FloatArray] = {}
        self._made: set[tuple[int, int]] = set()

    def pixels(self, flat: IntArray) -> FloatArray:
        """Values (P, 3) of pixels (flat indices)."""
        values = np.empty((len(flat), 3), np.float32)
        rows, columns = np.divmod(flat, self._width)
        for here, top, band in self._parts(rows, columns):
            values[here] = band[rows[here] - top, columns[here]]
        return values

    def between(self, u: NDArray[np.float64], v: NDArray[np.float64]) -> FloatArray:
        """Values (P, 3) at positions in the picture, pixel centres at .5."""
        values = np.empty((len(u), 3), np.float32)
        # As precise as ``bilinear`` takes them, which a band's first row is then taken from without rounding.
        x, y = (u - 0.5).astype(np.float32), (v - 0.5).astype(np.float32)
        rows, columns = (np.maximum(np.floor(at), 0).astype(np.int64) for at in (y, x))
        for here, top, band in self._parts(rows, columns):
            values[here] = bilinear(band, x[here].astype(np.float64) + 0.5, y[here].astype(np.float64) - top + 0.5)
        return values

    def _parts(self, rows: IntArray, columns: IntArray) -> Iterator[tuple[IntArray, int, FloatArray]]:
        """The pixels' places in parts that lie in one band each, the band's first row, and the band (h, W, 3).

        What lies up to _MARGIN_PIXELS pixels right and below is there too: neighbours count, also those that weigh
        nothing.
        """
        down, right = rows // _BLOCK_SIDE_PIXELS, columns // _BLOCK_SIDE_PIXELS
        further = np.minimum(columns + _MARGIN_PIXELS, self._width - 1) // _BLOCK_SIDE_PIXELS
        for band in np.unique(down):
            here = np.flatnonzero(down == band)
            for block in np.union1d(right[here], further[here]):
                self._make(int(band), int(block))
            yield here, int(band) * _BLOCK_SIDE_PIXELS, self._bands[int(band)]

    def _make(self, band: int, block: int) -> None:
        if (band, block) in self._made:
            return
        top, left = band * _BLOCK_SIDE_PIXELS, block * _BLOCK_SIDE_PIXELS
        bottom, right = (
            min(top + _BLOCK_SIDE_PIXELS + _MARGIN_PIXELS, self._height),
            min(left + _BLOCK_SIDE_PIXELS, self._width),
        )
        above, before = min(top, 1), min(left, 1)
        planes = self._planes(slice(top - above, bottom + 1), slice(left - before, right + 1))
        smooth = cv2.blur(cv2.merge(list(planes)), (3, 3))
        if band not in self._bands:
            self._bands.setdefault(band, np.empty((bottom - top, self._width, 3), np.float32))
        self._bands[band][:, left:right] = smooth[above : above + bottom - top, before : before + right - left]
        self._made.add((band, block))


class _Search:
    """Every view's wide mask, smoothed picture and rendered depth, which all rays are compared with."""

    def __init__(self, views: Sequence[SearchView], cores: Sequence[BoolArray], each: Each) -> None:
        self._views, self._cores = views, cores
        surfaces, wide = each(lambda view: view.surface(slice(None, None, 17)), views), each(_widen, views, cores)
        self._smooth = [_Smoothed(view.camera, partial(_picture, view)) for view in views]
        self._change = [_Smoothed(view.camera, partial(_difference, view)) for view in views]
        depths = np.concatenate(list(surfaces))
        near, far = np.percentile(depths[depths > 0], [1, 99]) if (depths > 0).any() else (1.0, 1.0)
        self._inverse = np.linspace(1 / (_NEAREST_DEPTH_SHARE * near), 1 / far, _RAY_DEPTHS)
        self._wide = list(wide)

    def rays(self, step: int, each: Each) -> list[_Rays]:
        """Rays of every ``step``-th pixel that a view misses, in the views' order, in parts of some _BATCH_RAYS."""

        def of_view(index: int) -> _Rays:
            return self._rays_of(index, self._views[index], np.flatnonzero(self._cores[index])[index % step :: step])

        joined = _join(list(each(of_view, range(len(self._views)))))
        count = len(joined.pixels)
        size = -(-count // max(1, count // _BATCH_RAYS))
        return [_take(joined, slice(at, at + size)) for at in range(0, count, max(1, size))]

    def _rays_of(self, index: int, view: SearchView, pixels: IntArray) -> _Rays:
        rows, columns = np.divmod(pixels, view.camera.width)
        return _Rays(
            np.full(len(pixels), index),
            pixels,
            np.broadcast_to(camera_centre(view.camera), (len(pixels), 3)),
            ray_directions(view.camera, columns + 0.5, rows + 0.5),
            view.surface(pixels),
            view.picture.reshape(3, -1).T[pixels],
            self._smooth[index].pixels(pixels),
        )

    def along_rays(self, rays: _Rays) -> _Seeds:
        """At most one seed per ray."""
        surface, count = rays.surface, len(rays.pixels)
        inverse = np.broadcast_to(self._inverse, (count, len(self._inverse)))
        limit = np.where(surface > 0, (1 - _IN_FRONT_SHARE) * surface, np.inf)
        ray, sample = np.nonzero(inverse * limit[:, None] > 1)
        ray, sample = self._inside_hull(rays, ray, sample)
        # Between the steps of the coarse search, which are a few pixels in the most distant views.
        ray = np.repeat(ray, 3)
        gap = self._inverse[0] - self._inverse[-1]
        offsets = np.array([-1, 0, 1]) / 3 * gap / max(1, len(self._inverse) - 1)
        depth = 1 / (self._inverse[sample][:, None] + offsets).ravel()
        points = rays.origins[ray] + rays.directions[ray] * depth[:, None]
        (cost,), front = self._disagreements([self._smooth], rays.views[ray], points, [rays.smooth[ray]])
        tolerance = np.float32(_MAX_SPREAD_LEVELS / 255)
        best = np.full(count, np.inf, np.float32)
        np.minimum.at(best, ray, np.where(front, cost, np.inf).astype(np.float32))
        explained = np.zeros(count, bool)
        asking = np.flatnonzero((best <= tolerance) & (surface > 0))
        disagreement = self._disagreement_at_surface(_take(rays, asking))
        explained[asking] = disagreement <= 2 * best[asking] + tolerance / 4
        fits = front & (cost <= np.minimum(best[ray] + _SAME_COST_SHARE * tolerance, tolerance)) & ~explained[ray]
        rows = np.flatnonzero(fits)
        rows = rows[np.lexsort((depth[rows], ray[rows]))]
        rows = rows[np.unique(ray[rows], return_index=True)[1]]  # the foremost of each ray
        ended, depth = _take(rays, ray[rows]), depth[rows]
        pixel = depth / np.array([view.camera.fx for view in self._views])[ended.views]
        return _Seeds(ended.origins + ended.directions * depth[:, None], ended.views, ended.colours, pixel, cost[rows])

    def _disagreement_at_surface(self, rays: _Rays) -> FloatArray:
        """Disagreement (R,) of the views at the rendered surface.

        The surface explains a pixel if the views agree on its colour there or, for texture too fine to compare, on its
        change. Rendered depths are slightly off, so nearby depths count as well.
        """
        changes = np.zeros((len(rays.pixels), 3), np.float32)
        for index in np.unique(rays.views):
            own = rays.views == index
            changes[own] = self._change[index].pixels(rays.pixels[own])
        reach, depths = rays.directions * rays.surface[:, None], (0.985, 1.0, 1.015)
        points = np.concatenate([rays.origins + nearer * reach for nearer in depths])
        views, smooth, change = (np.concatenate([each] * len(depths)) for each in (rays.views, rays.smooth, changes))
        disagreements, _ = self._disagreements((self._smooth, self._change), views, points, (smooth, change))
        return np.asarray(np.minimum(*disagreements).reshape(len(depths), -1).min(axis=0))

    def _inside_hull(self, rays: _Rays, ray: IntArray, sample: IntArray) -> tuple[IntArray, IntArray]:
        """The samples that lie inside the masks of nearly all other views that see them."""
        allowed = _MAX_NOT_MISSING_SHARE * len(self._views)
        seen = np.ones(len(ray), np.int64)
        misses = np.zeros(len(ray), np.int64)
        for other in _far_first(int(rays.views[0]), len(self._views)):
            points = rays.origins[ray] + rays.directions[ray] / self._inverse[sample][:, None]
            flat, *_ = _project(self._views[other], points)
            inside = (flat >= 0) & (rays.views[ray] != other)
            hit = inside & self._wide[other][np.maximum(flat, 0)]
            seen += inside
            misses += inside & ~hit
            keep = misses <= allowed
            ray, sample, seen, misses = ray[keep], sample[keep], seen[keep], misses[keep]
        keep = (misses <= _MAX_NOT_MISSING_SHARE * seen) & (seen - misses >= _MIN_MISSING_VIEWS)
        return ray[keep], sample[keep]

    def _disagreements(
        self,
        pictures: Sequence[Sequence[_Smoothed]],
        views: IntArray,
        points: NDArray[np.float64],
        references: Sequence[FloatArray],
    ) -> tuple[list[FloatArray], BoolArray]:
        """Difference (P,) of each kind of ``pictures`` from its reference colours (P, 3), 0..1; the points in front.

        The difference is the mean over the best views that see a point, except its own (``views``). A point is in
        front if it lies before the rendered surface of most views.
        """
        count = len(points)
        differences = np.full((len(pictures), len(self._views), count), np.inf, np.float32)
        before, seen = np.zeros(count, np.int64), np.zeros(count, np.int64)
        for other, view in enumerate(self._views):
            flat, u, v, depth = _project(view, points)
            inside = np.flatnonzero((flat >= 0) & (views != other))
            at = flat[inside]
            for kind, (each, reference) in enumerate(zip(pictures, references, strict=True)):
                colours = each[other].between(u[inside], v[inside])
                differences[kind, other, inside] = np.abs(colours - reference[inside]).max(axis=1)
            rendered = view.surface(at)
            before[inside] += (rendered <= 0) | (depth[inside] < (1 - _IN_FRONT_SHARE / 2) * rendered)
            seen[inside] += 1
        enough = seen >= _MIN_MISSING_VIEWS - 1
        return [_mean_of_best(each, seen, enough) for each in differences], enough & (before >= 0.7 * seen)


def _mean_of_best(differences: FloatArray, seen: IntArray, enough: BoolArray) -> FloatArray:
    """The mean (P,) of the smallest of each point's differences (V, P), infinite where not ``enough`` see it."""
    ordered = np.sort(differences, axis=0)
    wanted = np.ceil(_AGREEING_VIEWS_SHARE * seen).astype(np.int64)
    counted = np.arange(len(ordered))[:, None] < wanted
    total = np.where(counted, ordered, 0).sum(axis=0, dtype=np.float32)
    return np.where(enough, total / np.maximum(wanted, 1), np.inf).astype(np.float32)


def _widen(view: SearchView, core: BoolArray) -> BoolArray:
    """``core`` and the pixels missed by half as much, a pixel wider, flat: a new object may resemble what it hides."""
    missing = (missed_pixels(view, _MISSED_LEVELS / 2) | core).view(np.uint8)
    return cv2.dilate(missing, np.ones((3, 3), np.uint8)).view(np.bool_).ravel()


def _picture(view: SearchView, rows: slice, columns: slice) -> FloatArray:
    return view.picture[:, rows, columns]


def _difference(view: SearchView, rows: slice, columns: slice) -> FloatArray:
    return view.picture[:, rows, columns] - view.rendered[:, rows, columns]


def _far_first(index: int, count: int) -> list[int]:
    """All views, with directions unlike that of ``index`` early: neighbouring views carve little."""
    return sorted(range(count), key=lambda i: ((i - index) * 5 % count, i))


def _project(
    view: SearchView, points: NDArray[np.float64]
) -> tuple[IntArray, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Flat pixel of every point, -1 outside what was recorded; column, row (pixel centres at .5) and depth."""
    camera = view.camera
    x, y, depth = in_camera(camera, points).T
    front = depth > 1e-9
    reciprocal = 1 / np.where(front, depth, 1)
    # ``formats.cameras.project`` rounds differently, and streams depend on the last bits.
    u, v = camera.fx * x * reciprocal + camera.cx, camera.fy * y * reciprocal + camera.cy
    inside = front & in_picture(camera, u, v, depth)
    column, row = np.where(inside, u, 0).astype(np.int64), np.where(inside, v, 0).astype(np.int64)
    if view.recorded is not None:
        inside &= view.recorded[row, column]
    return np.where(inside, row * camera.width + column, -1), u, v, depth


def _confirm(seeds: _Seeds, step: int) -> _Seeds:
    """Points close to the end of another view's ray; every ``step``-th pixel had a ray.

    Chance agreements of colour have scattered depths. Close: in one cell of a grid or of the grid shifted by half.
    """
    if not len(seeds.points):
        return seeds
    size = _CELL_RAY_SPACINGS * max(1.5, step**0.5) * float(np.median(seeds.pixel))
    keep = np.zeros(len(seeds.views), bool)
    for shift in (0.0, 0.5):
        cells = np.floor((seeds.points - seeds.points.min(axis=0)) / size + shift).astype(np.int64)
        _, cell = np.unique(cells, axis=0, return_inverse=True)
        cell = cell.reshape(-1)
        present = np.zeros((int(cell.max()) + 1, int(seeds.views.max()) + 1), bool)
        present[cell, seeds.views] = True
        keep |= present.sum(axis=1)[cell] >= 2
    return _take(seeds, np.flatnonzero(keep))


def _thin(seeds: _Seeds, most: int) -> _Seeds:
    """One point, the best agreed on, per cell of a grid as wide as 1.5 pixels; cells grow until ``most`` suffice."""
    if not len(seeds.points):
        return seeds
    cell = 1.5 * float(np.median(seeds.pixel))
    order = np.argsort(seeds.cost, kind="stable")
    while True:
        cells = np.floor((seeds.points[order] - seeds.points.min(axis=0)) / cell).astype(np.int64)
        _, first = np.unique(cells, axis=0, return_index=True)
        if len(first) <= most:
            return _take(seeds, np.sort(order[first]))
        cell *= 1.2


def _splats(seeds: _Seeds, cores: Sequence[BoolArray], sh_degree: int) -> Splats:
    """Isotropic, half-transparent Gaussians, wide enough to close the gaps between them."""
    count = len(seeds.points)
    if not count:
        return empty_splats(sh_degree)
    # A view shows half of a body's surface. The spacing is in pixels, for seeds that cover all of it.
    area = 2 * sum(map(np.count_nonzero, cores)) / len(cores)
    spacing = float(np.clip(np.sqrt(area / count), 1.5, 6.0))
    sigmas = _SIGMA_PER_SPACING * spacing * seeds.pixel
    return round_splats(seeds.points, seeds.colours, sigmas, np.full(count, _SEED_OPACITY), sh_degree)
