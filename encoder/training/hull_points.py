"""Points of what a stage's hull shows and nothing stands for yet, from the pictures alone.

A plane sweep compares neighbours, so it misses a thing that neighbours see near their pictures' borders or before
nothing else; and what flies further in a frame than it is wide leaves its Gaussians behind. Where a view shows subject
and misses it, a ray gets a point at its foremost depth in the hull at which half of the views that look there show its
colour.

Source: photo hull (Kutulakos and Seitz 2000, "A theory of shape by space carving"), of single rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.subject.hull import without_margin
from decogs.formats.cameras import Camera, camera_centre, in_picture, project, ray_directions
from decogs.formats.geometry.axes import point_nearest_axes
from decogs.formats.splats import FloatArray
from decogs.rig.numerics import bilinear, floats
from decogs.rig.parallel import side_by_side
from decogs.rig.stage.stage import PlainStage, Stage
from decogs.rig.stage.subject import SubjectAlone
from decogs.rig.stage.views import StageView

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
F64 = NDArray[np.float64]

_MIN_LOOKING, _LEAST_LOOKING = 4, 3
"""Views, beside its own, that must look at a point; and of four views."""
_AGREEING_SHARE = 0.5
"""Share of them that must show its colour: a body hides its points from the others."""
_STEP_PIXELS = 1.5
"""Between depths along a ray, in the picture of a view from the side."""
_NEAREST, _FARTHEST = 0.2, 2.0
"""Depths that are searched, in units of the cameras' usual distance from the middle."""
_CHUNK_SAMPLES = 250_000
_MAX_RAYS = 4_000
"""Of a view: more are further apart."""


@dataclass(frozen=True)
class Rule:
    """How sure a kind of stage can be.

    ``difference``: of agreeing colours, 0..1. ``stride``: pixels between rays. ``has_backdrop``: it is drawn, too.
    """

    difference: float
    stride: int
    has_backdrop: bool


def rule_of(stage: Stage | None) -> Rule | None:
    """The rule of a subject with mattes or of a plain stage; None where a hull says too little of what stands there."""
    if isinstance(stage, SubjectAlone):
        return Rule(0.10, 2, has_backdrop=False)
    if isinstance(stage, PlainStage):
        # A plate's outline is less sure than a matte's, and shadows are in the hull, too.
        return Rule(0.05, 3, has_backdrop=True)
    return None


@dataclass(frozen=True)
class HullPoints:
    """Points ``xyz`` (P, 3) of ``rgb`` (P, 3) 0..1; ``spacing`` (P,), world units; ``seen`` (V, P): who agrees."""

    xyz: F64
    rgb: FloatArray
    spacing: FloatArray
    seen: BoolArray

    def __len__(self) -> int:
        return len(self.xyz)


def subject_pixels(stage: Stage) -> list[BoolArray]:
    """The pixels (H, W) of each view of the hull that show the subject, without its margin and blank borders."""
    if isinstance(stage, SubjectAlone):
        return list(stage.solid)
    cores = [(each, without_margin(each.subject)) for each in stage.hull.views]
    return [core if each.recorded is None else core & each.recorded for each, core in cores]


def hull_points(
    stage: Stage, views: Sequence[StageView], missing: Sequence[BoolArray], rule: Rule, *, most: int, threads: int = 1
) -> HullPoints:
    """At most ``most`` points where ``views``, those of the hull, have ``missing`` pixels (H, W). Deterministic."""
    search = _Search(stage, views, rule)
    with side_by_side(threads) as each:
        parts = list(each(search.of_view, range(len(views)), missing))
    ends = _thin(_join(parts), most)
    return HullPoints(ends.xyz, ends.rgb, ends.spacing, ends.seen.T.copy())


@dataclass(frozen=True)
class _Ends:
    """Ends of rays: positions (P, 3), colours (P, 3), spacing (P,), disagreement (P,), views that agree (P, V)."""

    xyz: F64
    rgb: FloatArray
    spacing: FloatArray
    cost: FloatArray
    seen: BoolArray


def _join(parts: Sequence[_Ends]) -> _Ends:
    return _Ends(*(np.concatenate([getattr(part, each.name) for part in parts]) for each in fields(_Ends)))


class _Search:
    """A stage's hull, and the pictures in which the views' colours are compared, smoothed against noise."""

    def __init__(self, stage: Stage, views: Sequence[StageView], rule: Rule) -> None:
        self._stage, self._views, self._rule = stage, views, rule
        self._least = min(_MIN_LOOKING, max(_LEAST_LOOKING, len(views) - 1))
        self._smooth = [floats(cv2.blur(view.picture, (3, 3))) for view in views]
        middle, _ = point_nearest_axes([view.camera for view in views])
        self._distance = float(np.median([np.linalg.norm(camera_centre(v.camera) - middle) for v in views]))

    def of_view(self, index: int, missing: BoolArray) -> _Ends:
        """The ends of the rays of a view's missing pixels."""
        pixels = _spread(missing, self._rule.stride)
        depths = self._depths(self._views[index].camera)
        size = max(1, _CHUNK_SAMPLES // len(depths))
        chunks = [pixels[at : at + size] for at in range(0, max(1, len(pixels)), size)]
        parts = [self._along_rays(index, chunk, depths) for chunk in chunks]
        return _join(parts)

    def _depths(self, camera: Camera) -> F64:
        """Depths along a ray: a pixel of each is as wide as the depth itself asks for."""
        focal = float(np.sqrt(camera.fx * camera.fy))
        count = int(np.ceil(np.log(_FARTHEST / _NEAREST) * focal / _STEP_PIXELS))
        return np.geomspace(_NEAREST * self._distance, _FARTHEST * self._distance, max(2, count))

    def _along_rays(self, index: int, pixels: IntArray, depths: F64) -> _Ends:
        camera = self._views[index].camera
        rows, columns = np.divmod(pixels, camera.width)
        colours = self._smooth[index][rows, columns]
        ways = ray_directions(camera, columns + 0.5, rows + 0.5)
        open_ = ~self._is_explained(index, ways, colours, depths)
        ways, colours, pixels = ways[open_], colours[open_], pixels[open_]
        points = camera_centre(camera) + ways[:, None] * depths[:, None]
        ray, sample = np.nonzero(self._stage.may_show(points.reshape(-1, 3)).reshape(points.shape[:2]))
        cost, agreeing = self._disagreement(index, points[ray, sample], colours[ray])
        fits = np.flatnonzero(cost <= self._rule.difference)
        fits = fits[np.unique(ray[fits], return_index=True)[1]]  # the foremost of each ray
        ray, sample = ray[fits], sample[fits]
        picture = self._views[index].picture.reshape(-1, 3)
        focal = np.sqrt(camera.fx * camera.fy)
        spacing = floats(self._rule.stride * depths[sample] / focal)
        return _Ends(points[ray, sample], picture[pixels[ray]], spacing, cost[fits], agreeing[fits])

    def _is_explained(self, index: int, ways: F64, colours: FloatArray, depths: F64) -> BoolArray:
        """Rays (R,) whose colour the views agree on where they meet the backdrop: shadows lie in the hull, too."""
        if not isinstance(self._stage, PlainStage):
            return np.zeros(len(ways), bool)
        origin = camera_centre(self._views[index].camera)
        points = origin + ways[:, None] * depths[:, None]
        clearance = self._stage.surfaces.clearance(points.reshape(-1, 3)).reshape(points.shape[:2])
        beyond = clearance <= 0
        after = np.maximum(beyond.argmax(axis=1), 1)
        row = np.arange(len(ways))
        before, behind = clearance[row, after - 1], clearance[row, after]
        share = np.clip(before / np.maximum(before - behind, 1e-12), 0, 1)
        depth = depths[after - 1] + share * (depths[after] - depths[after - 1])
        cost, _ = self._disagreement(index, origin + ways * depth[:, None], colours)
        return np.asarray(beyond.any(axis=1) & (cost <= self._rule.difference))

    def _disagreement(self, index: int, points: F64, colours: FloatArray) -> tuple[FloatArray, BoolArray]:
        """By how much the views differ, (P,), from colours (P, 3) at points (P, 3), and those that do not, (P, V)."""
        differences = np.full((len(points), len(self._views)), np.inf, np.float32)
        for other, view in enumerate(self._views):
            if other == index:
                continue
            u, v, depth = project(view.camera, points)
            rows = np.flatnonzero(in_picture(view.camera, u, v, depth))
            rows = rows[view.recorded[v[rows].astype(np.int64), u[rows].astype(np.int64)]]
            shown = bilinear(self._smooth[other], u[rows], v[rows])
            differences[rows, other] = np.abs(shown - colours[rows]).max(axis=1)
        looking = np.isfinite(differences).sum(axis=1)
        last = np.maximum(np.ceil(_AGREEING_SHARE * looking).astype(np.int64) - 1, 0)
        cost = np.sort(differences, axis=1)[np.arange(len(points)), last]
        agreeing = differences <= self._rule.difference
        agreeing[:, index] = True
        return np.where(looking >= self._least, cost, np.inf).astype(np.float32), agreeing


def _spread(mask: BoolArray, stride: int) -> IntArray:
    """Flat pixels of the mask on a grid, so far apart that they are at most _MAX_RAYS."""
    stride = max(stride, int(np.ceil(np.sqrt(np.count_nonzero(mask) / _MAX_RAYS))))
    grid = np.zeros_like(mask)
    grid[stride // 2 :: stride, stride // 2 :: stride] = True
    return np.flatnonzero(mask & grid)


def _thin(ends: _Ends, most: int) -> _Ends:
    """The end most agreed on of each cell of a grid as wide as the spacing; cells grow until ``most`` suffice."""
    if not len(ends.xyz):
        return ends
    cell = float(np.median(ends.spacing))
    order = np.argsort(ends.cost, kind="stable")
    while True:
        cells = np.floor((ends.xyz[order] - ends.xyz.min(axis=0)) / cell).astype(np.int64)
        first = np.sort(order[np.unique(cells, axis=0, return_index=True)[1]])
        if len(first) <= max(1, most):
            return _Ends(*(getattr(ends, each.name)[first] for each in fields(_Ends)))
        cell *= 1.2
