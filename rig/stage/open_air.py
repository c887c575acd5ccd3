"""The open sky behind a scene: found in the first frame's pictures, with Gaussians for it and the space it shows free.

Sky has no depth and no texture: training hangs it as haze in front of trees and roofs. So where it is found, a dome
stands far behind everything before training begins, and what comes between it and a view that shows it goes.
For users: docs/stages.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.subject.hull import BoolArray, Hull, SubjectView
from decogs.formats.cameras import camera_centre, ray_directions, rig_extent, turned
from decogs.formats.geometry.up_direction import up_of
from decogs.formats.splats import FloatArray, Splats, round_splats

from ..mattes.filling import push_pull
from ..numerics import floats
from ..pictures.ingest import RigFrame, View
from .plain import smooth_pixels
from .views import StageView, stage_view

_DECISION_PIXELS = 62_000
"""Of a view in which the sky is sought; larger pictures are shrunk."""
_CELL_DEGREES = 0.75
"""Side of the cells of directions in which views are compared: a pixel or two of a small picture."""
_MIN_CELLS = 160
_MIN_CELL_VIEWS = 3
"""Cells that so many views must show as sky."""
_MAX_DEVIATION_LEVELS = 1.5
"""Of the views' colours in a cell, where their rays are compared at infinity: more is no sky, or one that moves.
Small differences of each camera's colours are taken off before."""
_MAX_DEVIATION_RATIO = 1.15
"""Of this deviation to that on any nearer sphere: a wall agrees best where it stands."""
_SPHERES = (1.0, 2.0, 4.0, 8.0)
"""Radii of these, in rig sizes."""
_MIN_DISTANCE, _DISTANCE_PERCENTILE = 4.0, 95.0
"""Of the scene's points, in rig sizes: rooms are not as deep."""
_MIN_CONFIRMED_SHARE = 0.5
"""Of the cells of a region of sky that several views see, the share that they must show in the same colour."""
_SAME_LEVELS = 8.0
"""Difference of colour up to which two views show the same in a cell."""
_MAX_OFFSET_LEVELS = 8.0
"""Of a camera's colour of the sky from that of the others, which is taken off: what is left of differences between
cameras where colours are brightest."""
_ALIGNMENTS = 3
"""How often: the mean of all moves with each camera's."""
_GROWN_LEVELS = 6.0
"""Difference from the dome up to which a pixel shows it, beside what is surely sky, in 8-bit steps or noise."""
_GROWTHS = 3
"""How often: each view shows colours of directions in which others were not sure."""
_MARGIN_PIXELS = 1
_DOME_DISTANCE = 50.0
"""Of the dome's Gaussians from the rig's middle, in rig sizes: parallax is a fiftieth of a turn at most."""
_MAX_REACH = 10.0
"""Of the factor by which far points may move further in a step: as far as the parallax of their depth shows."""
_SPACING_DEGREES = 3.0
_OPACITY, _SIGMA_SPACINGS = 0.8, 0.75
"""Of the dome's Gaussians: together they let nothing through."""
_BESIDE_DEGREES = 6.0
"""Beyond the sky that was seen, the dome goes on for so far."""


@dataclass(frozen=True)
class OpenAir:
    """A scene before the sky. ``hull``: of what may stand before it; ``centre`` (3,), ``size``: of the rig.

    ``ways`` (D, 3), ``rgb`` (D, 3) 0..1: directions and colours of the dome.
    """

    hull: Hull
    centre: NDArray[np.float64]
    size: float
    ways: NDArray[np.float64]
    rgb: FloatArray

    is_closed = False

    def in_frame(self, views: Sequence[View], frame: RigFrame, used: Sequence[int]) -> OpenAir:
        """The same with what stands before the sky in a later frame, from the ``used`` ones of its pictures."""
        seen = [stage_view(views[i], frame.training[i], _DECISION_PIXELS) for i in used]
        return replace(self, hull=_hull(_Sky.of(seen)))

    def backdrop(self, sh_degree: int) -> Splats:
        """Gaussians for the sky, together opaque."""
        distance = _DOME_DISTANCE * self.size
        sigma = np.full(len(self.ways), _SIGMA_SPACINGS * np.radians(_SPACING_DEGREES) * distance)
        xyz = self.centre + distance * self.ways
        return round_splats(xyz, self.rgb, sigma, np.full(len(xyz), _OPACITY), sh_degree)

    def free(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) before the dome through which some view shows the sky."""
        return ~self.on_backdrop(xyz) & self.hull.denies(xyz)

    def on_backdrop(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) on the dome or near it."""
        return np.asarray(np.linalg.norm(xyz - self.centre, axis=1) > 0.5 * _DOME_DISTANCE * self.size)

    def reach(self, xyz: NDArray[np.floating]) -> FloatArray:
        """Factors by which points (P, 3) may move further than those near the cameras."""
        far = np.linalg.norm(xyz - self.centre, axis=1) / self.size
        return np.asarray(np.clip(far, 1, _MAX_REACH), np.float32)

    def may_show(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) at which no view shows the sky."""
        return ~self.hull.denies(xyz)


def find_open_air(views: Sequence[View], frame: RigFrame, xyz: NDArray[np.floating]) -> OpenAir | None:
    """The sky in the first ``frame`` of ``views``, if it shows one; ``xyz`` (P, 3): the scene's points.

    A sky is smooth to the pictures' upper border, brighter than the rest, the same in every view at infinity and less
    so on any nearer sphere, behind a scene that is deep.
    """
    centre, size = _rig(views)
    if frame.alpha or size <= 0 or not len(xyz):
        return None
    distances = np.linalg.norm(xyz - centre, axis=1)
    if np.percentile(distances, _DISTANCE_PERCENTILE) < _MIN_DISTANCE * size:
        return None
    return _shown_sky(views, frame, centre, size)


def open_air_of(views: Sequence[View], frame: RigFrame, means: NDArray[np.floating]) -> OpenAir | None:
    """The sky of a keyframe whose Gaussians, at ``means`` (N, 3), have a dome, if the ``frame`` shows it."""
    centre, size = _rig(views)
    far = np.linalg.norm(means - centre, axis=1) > 0.5 * _DOME_DISTANCE * size
    if frame.alpha or size <= 0 or np.count_nonzero(far) < _MIN_CELLS:
        return None
    # Far Gaussians alone are no dome: a narrow rig's background is as far away.
    return _shown_sky(views, frame, centre, size)


def _shown_sky(views: Sequence[View], frame: RigFrame, centre: NDArray[np.float64], size: float) -> OpenAir | None:
    """The sky of the pictures, if they show one."""
    seen = [stage_view(*each, _DECISION_PIXELS) for each in zip(views, frame.training, strict=True)]
    sky = _Sky.of(seen)
    return _open_air(sky, centre, size) if _is_sky(seen, sky, centre, size) else None


def _rig(views: Sequence[View]) -> tuple[NDArray[np.float64], float]:
    cameras = [view.pinhole for view in views]
    return np.mean([camera_centre(camera) for camera in cameras], axis=0), rig_extent(cameras)


def _open_air(sky: _Sky, centre: NDArray[np.float64], size: float) -> OpenAir:
    ways = _spread_directions(sky.axes)
    cells = sky.cells(ways)
    reach = round(_BESIDE_DEGREES / _CELL_DEGREES)
    near = cv2.dilate((sky.counts > 0).astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)).ravel()[cells] > 0
    return OpenAir(_hull(sky), centre, size, ways[near], sky.colours.reshape(-1, 3)[cells[near]])


def _hull(sky: _Sky) -> Hull:
    """What may stand before the sky: all but its masks, with a margin."""
    kernel = np.ones((2 * _MARGIN_PIXELS + 1,) * 2, np.uint8)
    return Hull(
        [
            SubjectView(view.camera, cv2.dilate((~mask).view(np.uint8), kernel).view(np.bool_))
            for view, mask in zip(sky.views, sky.masks, strict=True)
        ]
    )


@dataclass(frozen=True)
class _Sky:
    """The pixels (H, W) of each view that show the sky, and its colours by direction.

    ``views``: with pictures whose skies have one colour. ``axes`` (3, 3): rows, the last one up. ``counts`` (h, w):
    views that show each cell as sky; ``colours`` (h, w, 3).
    """

    views: Sequence[StageView]
    axes: NDArray[np.float64]
    masks: Sequence[BoolArray]
    counts: NDArray[np.int64]
    colours: FloatArray

    @staticmethod
    def of(seen: Sequence[StageView]) -> _Sky:
        """Regions that reach the upper border, agree between views, and are grown by the colour of their direction."""
        axes = _axes(seen)
        ways = [_directions(view) for view in seen]
        above = [(way @ axes[2] > 0).reshape(view.recorded.shape) for way, view in zip(ways, seen, strict=True)]
        surely = [_upper_regions(view, up) for view, up in zip(seen, above, strict=True)]
        cells = [_cells(way, axes) for way in ways]
        labels = [_regions(mask, 4) for mask in surely]
        seen = _aligned(seen, surely, cells)
        counts, colours, _ = _by_cell(seen, surely, cells)
        masks = []
        for view, label, cell in zip(seen, labels, cells, strict=True):
            masks.append(_confirmed(view, label, cell, counts, colours))
        shape = _grid()
        for _ in range(_GROWTHS):
            counts, colours, _ = _by_cell(seen, masks, cells)
            dome = push_pull(colours.reshape(*shape, 3), (counts > 0).astype(np.float32).reshape(shape))
            masks = [
                _grown(view, mask, up, dome.reshape(-1, 3)[cell])
                for view, mask, up, cell in zip(seen, masks, above, cells, strict=True)
            ]
        return _Sky(seen, axes, masks, counts.reshape(shape), dome)

    def cells(self, ways: NDArray[np.float64]) -> NDArray[np.int64]:
        """Cells, counted by row, of directions (P, 3)."""
        return _cells(ways, self.axes)


def _is_sky(seen: Sequence[StageView], sky: _Sky, centre: NDArray[np.float64], size: float) -> bool:
    if np.count_nonzero(sky.counts >= _MIN_CELL_VIEWS) < _MIN_CELLS:
        return False
    inside = np.concatenate([view.picture[mask].mean(1) for view, mask in zip(seen, sky.masks, strict=True)])
    others = [view.picture[view.recorded & ~mask].mean(1) for view, mask in zip(seen, sky.masks, strict=True)]
    outside = np.concatenate(others)
    if not len(outside) or np.median(inside) <= np.median(outside):
        return False
    far = [_directions(view) for view in seen]
    if not _deviation(sky.views, sky, far) <= _MAX_DEVIATION_LEVELS:
        return False
    # Nothing is taken off here: a wall with a gradient is alike at infinity but for an offset a camera.
    deviation = _deviation(seen, sky, far)
    for radius in _SPHERES:
        nearer = _deviation(seen, sky, [_on_sphere(view, centre, radius * size) for view in seen])
        if deviation > _MAX_DEVIATION_RATIO * nearer:
            return False
    return True


def _deviation(views: Sequence[StageView], sky: _Sky, ways: Sequence[NDArray[np.float64]]) -> float:
    """Median over cells of the deviation of views' colours where their rays point ``ways``, in 8-bit steps."""
    counts, _, squares = _by_cell(views, sky.masks, [sky.cells(way) for way in ways])
    enough = counts >= _MIN_CELL_VIEWS
    return 255 * float(np.sqrt(np.median(squares[enough]))) if enough.any() else np.inf


def _by_cell(
    seen: Sequence[StageView], masks: Sequence[BoolArray], cells: Sequence[NDArray[np.int64]]
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Of every cell: views that show it in their masks, the mean of their colours (C, 3), and its variance (C,)."""
    most = int(np.prod(_grid()))
    count, total, square = np.zeros(most, np.int64), np.zeros((most, 3)), np.zeros((most, 3))
    for view, mask, cell in zip(seen, masks, cells, strict=True):
        at, rgb = cell[mask.ravel()], view.picture[mask]
        number = np.bincount(at, minlength=most)
        shown = number > 0
        mean = np.stack([np.bincount(at, rgb[:, c], most) for c in range(3)], axis=1)[shown] / number[shown, None]
        count[shown] += 1
        total[shown] += mean
        square[shown] += mean**2
    mean = total / np.maximum(count, 1)[:, None]
    variance = (square / np.maximum(count, 1)[:, None] - mean**2).mean(1)
    return count, mean.astype(np.float32), np.maximum(variance, 0).astype(np.float32)


def _aligned(
    seen: Sequence[StageView], masks: Sequence[BoolArray], cells: Sequence[NDArray[np.int64]]
) -> list[StageView]:
    """The views without small differences of each camera's colours from those of all, in what several show as sky."""
    aligned = list(seen)
    for _ in range(_ALIGNMENTS):
        counts, colours, _ = _by_cell(aligned, masks, cells)
        for index, (view, mask, cell) in enumerate(zip(aligned, masks, cells, strict=True)):
            shared = mask.ravel() & (counts[cell] >= 2)
            if shared.any():
                picture = view.picture - np.median(view.picture.reshape(-1, 3)[shared] - colours[cell[shared]], axis=0)
                if 255 * np.abs(picture - seen[index].picture).max() <= _MAX_OFFSET_LEVELS:
                    aligned[index] = replace(view, picture=floats(picture))
    return aligned


def _upper_regions(view: StageView, above: BoolArray) -> BoolArray:
    """Smooth pixels above the horizon, connected with the first recorded ones of their columns."""
    smooth = smooth_pixels(view.picture) & above & view.recorded
    labels = _regions(smooth, 4)
    first = view.recorded.argmax(axis=0) + 2  # two rows in: smoothness is of windows
    rows = np.minimum(first, labels.shape[0] - 1)
    reached = np.zeros(labels.max() + 1, bool)
    reached[labels[rows, np.arange(labels.shape[1])]] = True
    reached[0] = False
    return np.asarray(reached[labels])


def _regions(mask: BoolArray, connectivity: int) -> NDArray[np.int32]:
    """Numbers (H, W) of the connected regions of a mask, from 1; 0 outside."""
    return np.asarray(cv2.connectedComponents(mask.view(np.uint8), connectivity=connectivity)[1], np.int32)


def _confirmed(
    view: StageView, labels: NDArray[np.int32], cells: NDArray[np.int64], counts: NDArray[np.int64], colours: FloatArray
) -> BoolArray:
    """The regions (H, W) that other views show in the same colour, where they show the same directions as sky."""
    difference = 255 * np.abs(view.picture.reshape(-1, 3) - colours[cells]).max(1)
    shared = counts[cells] >= 2
    flat = labels.ravel()
    all_shared = np.bincount(flat[shared], minlength=flat.max() + 1)
    same = np.bincount(flat[shared & (difference <= _SAME_LEVELS)], minlength=flat.max() + 1)
    right = same >= np.maximum(_MIN_CONFIRMED_SHARE * all_shared, 1)
    right[0] = False
    return np.asarray(right[labels])


def _grown(view: StageView, mask: BoolArray, above: BoolArray, dome: FloatArray) -> BoolArray:
    """The sky (H, W) with the pixels beside it, above the horizon, that have the colour of the ``dome`` (H * W, 3)."""
    difference = 255 * np.abs(floats(cv2.blur(view.picture, (3, 3))) - dome.reshape(view.picture.shape)).max(2)
    like = ((difference <= _GROWN_LEVELS) & above & view.recorded) | mask
    labels = _regions(like, 8)
    reached = np.zeros(labels.max() + 1, bool)
    reached[labels[mask]] = True
    reached[0] = False
    return np.asarray(reached[labels])


def _axes(seen: Sequence[StageView]) -> NDArray[np.float64]:
    """An orthonormal base (3, 3), in rows, whose last is up."""
    up = up_of([view.camera for view in seen])
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    return np.stack([side, np.cross(up, side), up])


def _directions(view: StageView) -> NDArray[np.float64]:
    """Unit directions (H * W, 3) of the pixels, in the world."""
    rows, columns = np.indices(view.recorded.shape).reshape(2, -1) + 0.5
    ways = ray_directions(view.camera, columns, rows)
    return np.asarray(ways / np.linalg.norm(ways, axis=1)[:, None])


def _on_sphere(view: StageView, centre: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Directions (H * W, 3), from the ``centre`` of a sphere, of the points where the pixels' rays leave it."""
    ways, origin = _directions(view), camera_centre(view.camera) - centre
    along = ways @ origin
    reach = -along + np.sqrt(np.maximum(along**2 - origin @ origin + radius**2, 0))
    points = origin + reach[:, None] * ways
    return np.asarray(points / np.maximum(np.linalg.norm(points, axis=1), 1e-12)[:, None])


def _grid() -> tuple[int, int]:
    """Rows and columns of cells: of a half turn from up to down, and of a whole one around."""
    return round(180 / _CELL_DEGREES), round(360 / _CELL_DEGREES)


def _cells(ways: NDArray[np.float64], axes: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cells, counted by row, of unit directions (P, 3)."""
    height, width = _grid()
    x, y, z = (turned(axes, ways)).T
    row = np.arccos(np.clip(z, -1, 1)) / np.pi * height
    column = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * width
    return np.asarray(
        np.minimum(row.astype(np.int64), height - 1) * width + np.minimum(column.astype(np.int64), width - 1)
    )


def _spread_directions(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Directions (P, 3) evenly over the upper half of the sphere, and a little below (Fibonacci's lattice)."""
    area = np.radians(_SPACING_DEGREES) ** 2 * np.sqrt(3) / 2
    count = round(4 * np.pi / area)
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    turn = np.pi * (1 + np.sqrt(5)) * index
    flat = np.sqrt(1 - z * z)
    ways = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    return np.asarray(ways[z > -np.sin(np.radians(_SPACING_DEGREES))] @ axes)
