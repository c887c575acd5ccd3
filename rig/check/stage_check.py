"""What to expect of a plain stage before it is encoded: backdrop, subject, cameras around it, shadows, a key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import Undistortion
from decogs.decoder.subject.hull import Hull
from decogs.formats.cameras import Camera, camera_centre, in_picture, project, ray_directions
from decogs.formats.colours.srgb import LUMA
from decogs.formats.splats import FloatArray

from ..pictures.ingest import display_referred
from ..stage.plain import subject_pixels
from ..stage.stage import BackdropStage, PlainRoom, PlainStage
from ..stage.surfaces import surface_colours

F64 = NDArray[np.float64]

_MIN_SATURATION = 0.15
"""Chroma of a backdrop, relative to its luma, from which it has a colour to key: greys of cameras have up to .05."""
_KEY_DEGREES, _KEY_SATURATION = 15.0, 0.5
"""What a key takes for the backdrop: colours within this angle of its own, of at least this share of its saturation."""
_CLEAN_WORN_SHARE, _CLEAN_SPREAD_DEGREES = 0.05, 8.0
"""Largest share of the subject that a key takes, and spread of the backdrop's angle, with which it is clean. Outlines
and gaps make 1 to 4 % where nobody wears the colour; screens are within 8 degrees."""
_KEY_LUMA = 0.3
"""Least luma of what a key takes, in units of the backdrop's: darker colours are noise."""
_MIN_DIFFERENCE = 20 / 255
"""Least difference of the subject from the backdrop that other views show there: less is a gap of the subject."""
_INNER = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
"""What is taken off a hull, which has a margin, to leave the pixels inside the outlines."""
_SPREAD_PERCENTILE = 95.0
_MIN_SHADOW_VIEWS = 3
"""Views that must show a place of the backdrop, all of them darker than the plate, to call it a shadow: whoever stands
before it in one stands elsewhere in another."""
_SHADOW_LIGHT = 0.92
"""Largest luma of a shadow, in units of the plate's: half of what makes a subject in a bright backdrop."""
_DARKEST_PERCENTILE = 2.0
_SAMPLES = 300
"""Pixels of a camera's subject that are looked at."""
_DEPTHS = 64
"""Places along a pixel's ray at which the hull or the backdrop is looked for ..."""
_NEAREST, _BEYOND = 0.5, 1.5
"""... from this share of the distance to the stage's middle, to so many of the surfaces' radii beyond it."""


@dataclass(frozen=True)
class KeyCheck:
    """The backdrop as a key. ``angle``: of its colour in CbCr, degrees; ``spread``: how far most of it is from that.

    ``worn``: share of the subject that has the backdrop's colour, worn or reflected: a key would make holes there.
    """

    angle: float
    spread: float
    worn: float

    @property
    def is_clean(self) -> bool:
        """Whether a key tells subject and backdrop apart."""
        return self.worn <= _CLEAN_WORN_SHARE and self.spread <= _CLEAN_SPREAD_DEGREES


@dataclass(frozen=True)
class StageCheck:
    """A plain stage as its first pictures show it.

    ``colour``: of the backdrop, RGB in 8-bit levels. ``plain``: its share of the median picture; ``subject``: share of
    each camera's picture that shows what stands before it. ``floor``: how far it lies below the median camera, and
    ``wall``: how far from what the cameras look at, world units; None where even light leaves that open. ``gap``: the
    largest angle between neighbours around the upright axis, degrees, and the ``gap_cameras``. ``shadow``: the darkest
    shadows' light, in units of the backdrop's; 1 without any. ``key``: None for a backdrop that has not one colour.
    """

    colour: tuple[int, int, int]
    plain: float
    subject: dict[str, float]
    floor: float | None
    wall: float | None
    gap: float
    gap_cameras: tuple[str, str]
    shadow: float
    key: KeyCheck | None

    def table(self) -> Iterator[str]:
        """For the user: a line for each thing to know."""
        shares = list(self.subject.values())
        yield (
            f"plain stage: the backdrop has the colour {' '.join(map(str, self.colour))} and {self.plain:.0%} of a "
            f"picture, what stands before it {np.median(shares):.0%} ({min(shares):.0%} to {max(shares):.0%})"
        )
        if self.floor is None or self.wall is None:
            yield "floor and wall: not found in so even a light; the backdrop is taken for a far sphere"
        else:
            yield f"floor: {self.floor:.3g} units below the cameras; wall: about {self.wall:.2g} units from the middle"
        yield _gap_line(self.gap, self.gap_cameras)
        dark = f"up to {1 - self.shadow:.0%} darker" if self.shadow < 1 else "none found"
        yield f"shadows on the backdrop: {dark}"
        yield f"key: {self._key()}"

    def _key(self) -> str:
        if self.key is None:
            return (
                "the backdrop has not one colour to key; a clean picture of each camera, or masks, cut the subject out"
            )
        state = "clean" if self.key.is_clean else "not clean"
        return (
            f"{state}: most of the backdrop is within {self.key.spread:.1f} degrees of its hue, and "
            f"{self.key.worn:.1%} of the subject has its colour"
        )


@dataclass(frozen=True)
class RoomCheck:
    """A room with plain walls round a floor with texture, as its first pictures show it.

    ``plain``: share of the median picture that shows the walls. ``floor``: how far it lies below the median camera, and
    ``wall``: how far from what the cameras look at, world units. ``gap``: as of a stage.
    """

    plain: float
    floor: float
    wall: float
    gap: float
    gap_cameras: tuple[str, str]

    def table(self) -> Iterator[str]:
        """For the user: a line for each thing to know."""
        yield (
            f"room with plain walls: they are {self.plain:.0%} of a picture, about {self.wall:.2g} units from the "
            f"middle; the floor has texture, {self.floor:.3g} units below the cameras"
        )
        yield _gap_line(self.gap, self.gap_cameras)


@dataclass(frozen=True)
class _Shown:
    """What a pinhole camera shows, (H, W, 3), its plate, and which of its pixels (H, W) were recorded."""

    camera: Camera
    picture: FloatArray
    plate: FloatArray
    recorded: NDArray[np.bool_]


def check_backdrop(
    backdrop: BackdropStage, cameras: Sequence[Camera], pictures: Sequence[NDArray[np.uint8]]
) -> StageCheck | RoomCheck | None:
    """Judges the ``backdrop`` that the first ``pictures`` (H, W, 3) of the ``cameras`` show, at its views' size."""
    if isinstance(backdrop, PlainStage):
        return check_stage(backdrop, cameras, pictures)
    return check_room(backdrop, cameras) if isinstance(backdrop, PlainRoom) else None


def check_room(room: PlainRoom, cameras: Sequence[Camera]) -> RoomCheck:
    """Describes the ``room`` around the ``cameras``."""
    floor = _below(room, cameras)
    assert floor is not None  # a room is found by its floor
    return RoomCheck(_plain_share(room), floor, room.surfaces.radius, *_largest_gap(room, cameras))


def check_stage(stage: PlainStage, cameras: Sequence[Camera], pictures: Sequence[NDArray[np.uint8]]) -> StageCheck:
    """Judges the ``stage`` that the first ``pictures`` (H, W, 3) of the ``cameras`` show, at its views' size."""
    plans = [Undistortion(camera) for camera in cameras]
    straight = [display_referred(plan.apply(own)) for plan, own in zip(plans, pictures, strict=True)]
    shown = [
        _Shown(view.camera, picture, view.plate, plan.valid)
        for view, picture, plan in zip(stage.views, straight, plans, strict=True)
    ]
    gap, between = _largest_gap(stage, cameras)
    backdrop = np.concatenate([picture[view.plain] for view, picture in zip(stage.views, straight, strict=True)])
    floor = _below(stage, cameras)
    red, green, blue = np.rint(255 * np.median(backdrop, axis=0)).astype(int).tolist()
    return StageCheck(
        (red, green, blue),
        plain=_plain_share(stage),
        subject={camera.name: _subject_share(stage, each) for camera, each in zip(cameras, shown, strict=True)},
        floor=floor,
        wall=None if floor is None else stage.surfaces.radius,
        gap=gap,
        gap_cameras=between,
        shadow=_shadow(stage, shown),
        key=_key(stage, shown, backdrop),
    )


def first_met(stage: PlainStage, centre: F64, rays: NDArray[np.floating]) -> F64:
    """Where rays (N, 3) from a camera's ``centre`` meet the stage's hull or its backdrop, world points (N, 3)."""
    distance = float(np.linalg.norm(stage.surfaces.middle - centre))
    depths = np.geomspace(_NEAREST * distance, distance + _BEYOND * stage.surfaces.radius, _DEPTHS)
    points = centre + depths[:, None] * rays[:, None]
    flat = points.reshape(-1, 3)
    ends = (stage.hull.holds(flat) | (stage.surfaces.clearance(flat) <= 0)).reshape(points.shape[:2])
    ends[:, -1] = True
    return np.asarray(points[np.arange(len(points)), ends.argmax(axis=1)])


def _subject_share(stage: PlainStage, view: _Shown) -> float:
    """Share of the picture that differs from the plate and lies in the hull: no shadow, no gap."""
    subject = subject_pixels(view.picture, view.plate) & view.recorded
    row, column = _sampled(subject)
    rays = ray_directions(view.camera, column + 0.5, row + 0.5)
    stands = ~stage.on_backdrop(first_met(stage, camera_centre(view.camera), rays))
    return float(subject[view.recorded].mean() * stands.mean()) if len(stands) else 0.0


def _sampled(pixels: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of some of the ``pixels`` (H, W), evenly spread."""
    row, column = np.nonzero(pixels)
    step = max(1, len(row) // _SAMPLES)
    return row[step // 2 :: step], column[step // 2 :: step]


def _shadow(stage: PlainStage, shown: Sequence[_Shown]) -> float:
    """The darkest shadows' light, in units of the plates'; 1 without shadows."""
    xyz, normals = stage.surfaces.points(stage.spacing / 4)
    brightest, counts = np.zeros(len(xyz)), np.zeros(len(xyz), np.int64)
    for view in shown:
        u, v, depth = project(view.camera, xyz)
        facing = ((camera_centre(view.camera) - xyz) * normals).sum(axis=1) > 0
        rows = np.flatnonzero(in_picture(view.camera, u, v, depth) & facing)
        rows = rows[view.recorded[v[rows].astype(np.int64), u[rows].astype(np.int64)]]
        at = v[rows].astype(np.int64), u[rows].astype(np.int64)
        light = cv2.blur(view.picture, (3, 3)) @ LUMA / np.maximum(view.plate @ LUMA, 1 / 255)
        brightest[rows] = np.maximum(brightest[rows], light[at])
        counts[rows] += 1
    dark = brightest[(counts >= _MIN_SHADOW_VIEWS) & (brightest < _SHADOW_LIGHT)]
    return float(np.percentile(dark, _DARKEST_PERCENTILE)) if len(dark) else 1.0


def _plain_share(stage: BackdropStage) -> float:
    """Plain share of the median picture, of what was recorded."""
    shown = zip(stage.views, stage.hull.views, strict=True)
    return float(np.median([replace(there, subject=view.plain).share for view, there in shown]))


def _below(stage: BackdropStage, cameras: Sequence[Camera]) -> float | None:
    """How far the floor lies below the median camera; None where it was not found."""
    surfaces = stage.surfaces
    if surfaces.floor is None:
        return None
    heights = [(camera_centre(camera) - surfaces.middle) @ surfaces.axes[2] for camera in cameras]
    return float(np.median(heights)) - surfaces.floor


def _gap_line(gap: float, cameras: tuple[str, str]) -> str:
    return f"cameras around the subject: the largest gap has {gap:.0f} degrees, between {' and '.join(cameras)}"


def _largest_gap(stage: BackdropStage, cameras: Sequence[Camera]) -> tuple[float, tuple[str, str]]:
    """The largest angle between neighbouring cameras around the upright axis, degrees, and their names."""
    gaps, order = stage.surfaces.gaps(np.array([camera_centre(camera) for camera in cameras]))
    widest = int(np.argmax(gaps))
    return float(gaps[widest]), (cameras[order[widest]].name, cameras[order[(widest + 1) % len(order)]].name)


def _key(stage: PlainStage, shown: Sequence[_Shown], backdrop: FloatArray) -> KeyCheck | None:
    """The stage's backdrop, of colours (N, 3), as a key."""
    screen = np.median(backdrop, axis=0)
    angle, saturation = (float(each.item()) for each in _chroma(screen[None]))
    if saturation < _MIN_SATURATION:
        return None
    spread = float(np.percentile(_against(angle, backdrop)[0], _SPREAD_PERCENTILE))
    if spread > _KEY_DEGREES:
        return None
    cores = [cv2.erode(each.subject.view(np.uint8), _INNER).view(np.bool_) for each in stage.hull.views]
    inner = Hull([replace(each, subject=core) for each, core in zip(stage.hull.views, cores, strict=True)])
    within = replace(stage, hull=inner)
    subject = np.concatenate([_inner_colours(within, *each) for each in zip(shown, cores, strict=True)])
    aside, strength = _against(angle, subject)
    screen_coloured = (aside <= _KEY_DEGREES) & (strength >= _KEY_SATURATION * saturation)
    screen_coloured &= subject @ LUMA >= _KEY_LUMA * (screen @ LUMA)
    return KeyCheck(angle, spread, float(screen_coloured.sum()) / max(len(screen_coloured), 1))


def _inner_colours(stage: PlainStage, view: _Shown, core: NDArray[np.bool_]) -> FloatArray:
    """Some colours (N, 3) that a view shows of what is in the hull, without the backdrop seen through its gaps."""
    row, column = _sampled(core & view.recorded)
    rays, centre = ray_directions(view.camera, column + 0.5, row + 0.5), camera_centre(view.camera)
    colours = view.picture[row, column]
    behind = first_met(replace(stage, hull=Hull([])), centre, rays)
    backdrop = surface_colours(stage.views, behind, stage.surfaces.middle - behind)
    stands = ~stage.on_backdrop(first_met(stage, centre, rays))
    return np.asarray(colours[stands & (np.abs(colours - backdrop).max(axis=1) > _MIN_DIFFERENCE)])


def _against(angle: float, colours: FloatArray) -> tuple[F64, F64]:
    """Degrees (N,) of colours (N, 3) from an angle in CbCr, and their saturation (N,)."""
    own, saturation = _chroma(colours)
    return np.abs((own - angle + 180) % 360 - 180), saturation


def _chroma(colours: FloatArray) -> tuple[F64, F64]:
    """Angle (N,) in the CbCr plane, degrees, and saturation (N,): chroma relative to luma. Source: ITU-R BT.601."""
    luma = colours @ LUMA
    blue, red = 0.564 * (colours[:, 2] - luma), 0.713 * (colours[:, 0] - luma)
    return np.degrees(np.arctan2(red, blue)), np.hypot(blue, red) / np.maximum(luma, 1 / 255)
