"""A plain stage: found in the first frame's pictures, with Gaussians for its backdrop and the space that stays free.

A plain surface confirms no depth: grey before grey costs no view anything, and training fills the space in front with
fog. So where most of the pictures is plain, the backdrop is there, opaque, before training begins, and first points lie
in the hull of what stands in front of it. Whatever leaves the hull goes. For users: docs/stages.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.subject.hull import BoolArray, Hull, SubjectView, with_margin
from decogs.formats.cameras import camera_centre
from decogs.formats.splats import FloatArray, Splats, round_splats

from ..pictures.ingest import RigFrame, View
from .plain import plain_pixels, plate_of, subject_pixels
from .room import pixels_beside, plain_points
from .subject import subject_alone
from .surfaces import PlainView, Surfaces, find_room, find_surfaces, plain_colours, surface_colours
from .views import StageView, stage_view

_MIN_PLAIN_SHARE = 0.5
"""Plain share of the median view's picture from which a stage is plain: rooms and textured stages have up to .45."""
_MIN_ROOM_SHARE = 0.3
"""Plain share of the median view's picture from which a room has plain walls."""
_MIN_SPAN_DEGREES = 90.0
"""Between the cameras that see a stage from most different sides. Of what a narrower arc stands before too little is
seen from two sides: on `hdr`, an arc of 48 degrees before walls that darkness makes plain, a backdrop cost 2 dB."""
_MAX_ROOM_GAP_DEGREES = 150.0
"""Between neighbouring cameras around a room, whose floor is found by texture: on half rings at wrong heights, too."""
_MIN_VIEWS = 4
"""Views from which a stage is sought: in the hull of three all around, no view confirms a first point."""
_DECISION_PIXELS = 62_000
"""Of a view in this decision; larger pictures are shrunk."""
_BACKDROP_GAUSSIANS = 4600
_OPACITY, _SIGMA_SPACINGS = 0.8, 0.75
"""Of the backdrop's Gaussians, the size in units of their distance: together they let nothing through."""
_SHARED_PER_SPACING = 4.0
"""Density of the points at which cameras' colours are compared, along a line."""
_FREE_SPACINGS = 1.5
"""Distance from the backdrop's surfaces, in these units, from which space is free: sweeps are curved."""


class Stage(Protocol):
    """What is known of the space in front of the cameras."""

    @property
    def hull(self) -> Hull:
        """Of what may stand there."""

    @property
    def is_closed(self) -> bool:
        """Whether backdrop and hull are all there is: nothing has to be guessed beside the pictures."""

    def in_frame(self, views: Sequence[View], frame: RigFrame, used: Sequence[int]) -> Stage:
        """The same in a later frame, from the ``used`` ones of its pictures."""

    def backdrop(self, sh_degree: int) -> Splats:
        """Gaussians for the backdrop, together opaque."""

    def free(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) of empty space: in front of the backdrop, where some view shows it."""

    def on_backdrop(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) on the backdrop or beyond it."""

    def may_show(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) at which a view may show something in front of the backdrop."""

    def reach(self, xyz: NDArray[np.floating]) -> FloatArray | None:
        """Factors (P,) of the step sizes at which points (P, 3) move; None for one."""


@dataclass(frozen=True)
class BackdropStage:
    """A stage with a backdrop: its surfaces, points on them, and the ``hull`` of what stands in front.

    ``views``: as the search sees them, with their plates. ``xyz`` (P, 3) world, ``rgb`` (P, 3) 0..1: evenly spread
    points of the backdrop, ``spacing`` world units apart.
    """

    hull: Hull
    surfaces: Surfaces
    views: Sequence[PlainView]
    xyz: FloatArray
    rgb: FloatArray
    spacing: float

    is_closed = True

    def backdrop(self, sh_degree: int) -> Splats:
        """Gaussians for the backdrop, together opaque."""
        sigmas, opacities = np.full(len(self.xyz), _SIGMA_SPACINGS * self.spacing), np.full(len(self.xyz), _OPACITY)
        return round_splats(self.xyz, self.rgb, sigmas, opacities, sh_degree)

    def free(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) of empty space: in front of the backdrop, where some view shows it."""
        return ~self.on_backdrop(xyz) & self.hull.denies(xyz)

    def on_backdrop(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) on the backdrop's surfaces or beyond them."""
        return np.asarray(self.surfaces.clearance(xyz) <= _FREE_SPACINGS * self.spacing)

    def may_show(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) in front of the backdrop, in the hull."""
        return np.asarray(self.hull.holds(xyz) & (self.surfaces.clearance(xyz) > 0))

    def reach(self, xyz: NDArray[np.floating]) -> None:
        """The same steps everywhere."""


@dataclass(frozen=True)
class PlainStage(BackdropStage):
    """A stage whose floor and walls are plain."""

    def in_frame(self, views: Sequence[View], frame: RigFrame, used: Sequence[int]) -> PlainStage:
        """The stage with the hull of a later frame, from the ``used`` ones of its pictures."""
        seen = [(stage_view(views[i], frame.training[i]), self.views[i].plate) for i in used]
        return replace(self, hull=Hull([_subject_view(*each) for each in seen]))

    def shared_points(self) -> tuple[FloatArray, BoolArray]:
        """Points (P, 3) of the backdrop, close enough for a camera's colours, and the views that show them, (V, P)."""
        xyz, normals = self.surfaces.points(self.spacing / _SHARED_PER_SPACING)
        seen = np.zeros((len(self.views), len(xyz)), bool)
        for view, row in zip(self.views, seen, strict=True):
            row[plain_colours(view, xyz, normals)[0]] = True
        return xyz.astype(np.float32), seen


@dataclass(frozen=True)
class PlainRoom(BackdropStage):
    """A room with plain walls behind a floor with texture. ``beside``: pixels (H, W) beside the walls, per view."""

    beside: Sequence[BoolArray]

    def may_show(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) in front of the backdrop or on it, in the hull: a floor's texture is denser than its layer."""
        return np.asarray(self.hull.holds(xyz) & (self.surfaces.clearance(xyz) > -_FREE_SPACINGS * self.spacing))

    def in_frame(self, views: Sequence[View], frame: RigFrame, used: Sequence[int]) -> PlainRoom:
        """The room with the hull of a later frame, from the ``used`` ones of its pictures."""
        seen = [(stage_view(views[i], frame.training[i]), self.views[i].plate, self.beside[i]) for i in used]
        return replace(self, hull=Hull([_subject_view(*each) for each in seen]))


def find_stage(views: Sequence[View], frame: RigFrame, least_span: float = _MIN_SPAN_DEGREES) -> Stage | None:
    """The stage in the first ``frame`` of ``views``: of a subject with mattes, or before plain walls; None for others.

    Enough cameras stand over a wide enough arc, of ``least_span`` degrees, and the median picture is mostly plain, or
    its upper part is.
    """
    if frame.alpha:
        return subject_alone(views, frame.alpha)
    share = _plain_share(views, frame.training) if len(views) >= _MIN_VIEWS else 0.0
    if share < _MIN_ROOM_SHARE:
        return None
    seen = [stage_view(*each) for each in zip(views, frame.training, strict=True)]
    plain = [plain_pixels(view.picture) & view.recorded for view in seen]
    return _plain_stage(seen, plain, least_span) if share >= _MIN_PLAIN_SHARE else _plain_room(seen, plain)


def _plain_stage(seen: Sequence[StageView], plain: Sequence[BoolArray], least_span: float) -> PlainStage | None:
    """The stage whose floor and walls are ``plain``."""
    plates = [plate_of(view.picture, mask) for view, mask in zip(seen, plain, strict=True)]
    subjects = [_subject_view(*each) for each in zip(seen, plates, strict=True)]
    backdrops = [
        PlainView(subject.camera, mask & ~subject.subject, plate)
        for subject, mask, plate in zip(subjects, plain, plates, strict=True)
    ]
    surfaces = find_surfaces(backdrops)
    if _span(surfaces, seen) < least_span:
        return None
    spacing = _spacing(surfaces)
    xyz, normals = surfaces.points(spacing)
    colours = surface_colours(backdrops, xyz, normals)
    return PlainStage(Hull(subjects), surfaces, backdrops, xyz.astype(np.float32), colours, spacing)


def _plain_room(seen: Sequence[StageView], plain: Sequence[BoolArray]) -> PlainRoom | None:
    """The room whose walls are ``plain``, and whose floor is not."""
    plates = [plate_of(view.picture, mask) for view, mask in zip(seen, plain, strict=True)]
    walls = [PlainView(view.camera, mask, plate) for view, mask, plate in zip(seen, plain, plates, strict=True)]
    whole = [PlainView(view.camera, view.recorded, view.picture) for view in seen]
    surfaces = find_room(walls, whole)
    if surfaces is None or _largest_gap(surfaces, seen) > _MAX_ROOM_GAP_DEGREES:
        return None
    spacing = _spacing(surfaces)
    xyz, normals = surfaces.points(spacing)
    on_floor = normals @ surfaces.axes[2] > 0.5
    on_wall = ~on_floor & plain_points(walls, xyz, normals)
    beside = [pixels_beside(view.camera, xyz, normals, on_wall) | ~view.recorded for view in seen]
    shown = [replace(wall, plain=wall.plain & ~other) for wall, other in zip(walls, beside, strict=True)]
    if np.median([view.plain.mean() for view in shown]) < _MIN_ROOM_SHARE:
        return None
    colours = np.where(on_floor[:, None], surface_colours(whole, xyz, normals), surface_colours(shown, xyz, normals))
    kept = on_floor | on_wall
    hull = Hull([_subject_view(*each) for each in zip(seen, plates, beside, strict=True)])
    return PlainRoom(hull, surfaces, shown, xyz[kept].astype(np.float32), colours[kept], spacing, beside)


def _spacing(surfaces: Surfaces) -> float:
    """Of so many hexagonally packed points on the surfaces."""
    return float(np.sqrt(surfaces.area / _BACKDROP_GAUSSIANS * 2 / 3**0.5))


def _largest_gap(surfaces: Surfaces, seen: Sequence[StageView]) -> float:
    """Degrees between neighbouring cameras around the stage, at most."""
    gaps, _ = surfaces.gaps(np.array([camera_centre(view.camera) for view in seen]))
    return float(gaps.max())


def _span(surfaces: Surfaces, seen: Sequence[StageView]) -> float:
    """Degrees between the two cameras that see the middle from most different sides."""
    ways = np.array([camera_centre(view.camera) for view in seen]) - surfaces.middle
    ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-12)
    return float(np.degrees(np.arccos(np.clip(ways @ ways.T, -1, 1).min())))


def _plain_share(views: Sequence[View], pictures: Sequence[FloatArray]) -> float:
    """Plain share of the median picture; 0 once most have too little for a room: the others are not looked at."""
    shares: list[float] = []
    for view, picture in zip(views, pictures, strict=True):
        small = stage_view(view, picture, _DECISION_PIXELS)
        shares.append(float((plain_pixels(small.picture) & small.recorded).mean()))
        if 2 * sum(share < _MIN_ROOM_SHARE for share in shares) > len(views):
            return 0.0
    return float(np.median(shares))


def _subject_view(view: StageView, plate: FloatArray, beside: BoolArray | None = None) -> SubjectView:
    """What differs from the plate, and what was not recorded or is ``beside`` it, and may be anything."""
    beside = ~view.recorded if beside is None else beside
    return SubjectView(view.camera, with_margin(subject_pixels(view.picture, plate) | beside))
