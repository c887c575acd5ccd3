"""What to expect of a rig before it is encoded: overlap of its cameras, pose errors, delays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, in_picture, project, ray_slopes, turned

from ..keyframe.backdrop.stage import PlainStage
from ..synchronisation.starts import frames_late
from .matches import Matches
from .reprojection import MAX_RAYS_ANGLE, epipolar_residuals, is_turned, triangulate, turns
from .rig_statistics import RigStatistics
from .stage_check import first_met

F64 = NDArray[np.float64]

RIGHT, ROUGH, WRONG = "right", "rough", "wrong"
"""Expected quality of new views between the cameras: right; right on the whole, with blurred details; not right."""
_EXPECTATIONS = {
    RIGHT: "new views between the cameras should look right",
    ROUGH: "new views between the cameras should look right on the whole, with blurred or broken details",
    WRONG: "new views between the cameras will not look right",
}
_RIGHT_SEEN_SHARE, _ROUGH_SEEN_SHARE = 0.7, 0.35
"""Least share of a camera's pixels that two others see."""
_RIGHT_GAP, _ROUGH_GAP = math.radians(20), math.radians(45)
"""Largest angle to the nearest camera that sees the same surface."""
_MISPLACED_PIXELS = 0.5
"""Least distance of a misplaced camera's matches from their epipolar lines, in pixels ..."""
_MISPLACED_RATIO = 4.0
"""... and in multiples of the other cameras' median."""
_GRID_SIZE = 16, 12
"""Columns and rows of the pixels that stand for a picture."""
_MIN_DEPTH_POINTS = 25
"""Triangulated points from which a camera's depths are known."""


@dataclass(frozen=True)
class CameraCheck:
    """One camera. ``seen_by_one``, ``seen_by_two``: shares of its pixels whose surface so many others see from an angle
    that gives the depth and still looks alike; NaN where no match says where it is. ``gap``: median angle, degrees, to
    the nearest of them, on a plain stage over what stands in front of the backdrop; NaN without any.
    ``residual``: distance, pixels, of the nearer matches of its best pair from their epipolar lines; ``turned``:
    degrees against the calibration, as the others' points say; both NaN where matches are too few. ``late``: frames
    behind the others; NaN where too little moves.
    """

    camera: str
    seen_by_one: float
    seen_by_two: float
    gap: float
    residual: float
    turned: float
    late: float
    misplaced: bool


@dataclass(frozen=True)
class RigCheck:
    """The cameras, and what to expect: RIGHT, ROUGH or WRONG; None for fewer than three cameras."""

    cameras: tuple[CameraCheck, ...]
    expected: str | None

    def warnings(self) -> Iterator[str]:
        """What the user should know before encoding, one line each."""
        for camera in self.cameras:
            if camera.misplaced:
                how = f"rotated by {camera.turned:.1f} degrees" if math.isfinite(camera.turned) else "misplaced"
                yield (
                    f"camera {camera.camera} appears {how} against its calibration: its matches do not fit the other "
                    "cameras' poses; calibrate it again, or leave it out"
                )
        off = sorted((each for each in self.cameras if abs(each.late) >= 0.5), key=lambda each: -abs(each.late))
        if off:
            others, most = (f" and {len(off) - 1} more", "up to ") if len(off) > 1 else ("", "")
            how = "late" if off[0].late > 0 else "early"
            frames = f"{abs(off[0].late):.3g} frame{'s'[: abs(off[0].late) != 1]}"
            yield (
                f"camera {off[0].camera}{others} appears {most}{frames} {how} against the others; find out when each "
                "one started (decogs-sync), or encode with --sync auto"
            )
        if self.expected == WRONG:
            yield f"{_EXPECTATIONS[WRONG]}: {self._why()}; add cameras in between"

    def table(self) -> Iterator[str]:
        """For the user: the verdict, and a row per camera."""
        if self.expected is not None:
            yield f"{_EXPECTATIONS[self.expected]}: {self._why()}"
        yield "camera                seen by one  by two  nearest view  epipolar residual    rotated  frames late"
        for each in self.cameras:
            figures = (
                (each.seen_by_one, 11, ".0%", ""),
                (each.seen_by_two, 6, ".0%", ""),
                (each.gap, 12, ".0f", " deg"),
                (each.residual, 17, ".2f", " px"),
                (each.turned, 9, ".2f", " deg"),
                (each.late, 11, ".3g", ""),
            )
            cells = [f"{_or_none(value, as_text, unit):>{width}}" for value, width, as_text, unit in figures]
            yield "  ".join([f"{each.camera:<20}", *cells])

    def _why(self) -> str:
        shares = [_known(each.seen_by_two) for each in self.cameras]
        gaps = [each.gap for each in self.cameras if math.isfinite(each.gap)]
        near = f"; the nearest view is {np.median(gaps):.0f} degrees away" if gaps else ""
        return f"two other cameras see {np.median(shares):.0%} of a camera's pixels{near} (medians)"


def check_rig(stats: RigStatistics, each: Callable[..., Iterator[Any]] = map) -> RigCheck:
    """Judges a rig by its calibration, the matches of its first pictures, and those of what moves."""
    late = stats.step * frames_late(stats.cameras, stats.pictures, each)
    return judge_rig(stats.cameras, stats.matches, late, stats.stage)


def judge_rig(cameras: Sequence[Camera], matches: Matches, late: F64, stage: PlainStage | None = None) -> RigCheck:
    """The check by the matches of the cameras' first pictures; ``late`` (cameras,) in frames, NaN where unknown.

    On a plain ``stage``, whose backdrop has no matches, its surfaces and hull say what the cameras see.
    """
    residuals, turned_by = epipolar_residuals(cameras, matches), turns(cameras, matches)
    known = residuals[np.isfinite(residuals)]
    usual = float(np.median(known)) if len(known) else math.nan
    checks = []
    for row, camera in enumerate(cameras):
        shown = _matched_surface(cameras, matches, row) if stage is None else _stage_surface(stage, camera)
        by_one, by_two, gap = _coverage(cameras, row, shown)
        beside = residuals[row] >= max(_MISPLACED_PIXELS, _MISPLACED_RATIO * usual)
        misplaced = is_turned(camera, turned_by[row]) if math.isfinite(turned_by[row]) else beside
        checks.append(
            CameraCheck(
                camera.name,
                seen_by_one=by_one,
                seen_by_two=by_two,
                gap=gap,
                residual=float(residuals[row]),
                turned=float(turned_by[row]),
                late=float(late[row]),
                misplaced=bool(misplaced),
            )
        )
    return RigCheck(tuple(checks), _expected(checks))


def _expected(checks: Sequence[CameraCheck]) -> str | None:
    if len(checks) < 3:
        return None
    seen = float(np.median([_known(check.seen_by_two) for check in checks]))
    gaps = [check.gap for check in checks if math.isfinite(check.gap)]
    gap = math.radians(float(np.median(gaps))) if len(gaps) * 2 > len(checks) else math.inf
    if seen >= _RIGHT_SEEN_SHARE and gap <= _RIGHT_GAP:
        return RIGHT
    return ROUGH if seen >= _ROUGH_SEEN_SHARE and gap <= _ROUGH_GAP else WRONG


def _known(share: float) -> float:
    """A share of pixels, 0 where it is not known: what no match finds, training hardly finds."""
    return share if math.isfinite(share) else 0.0


@dataclass(frozen=True)
class _Shown:
    """World points (N, 3) that a camera's pixels show, and which of them (N,) need a second camera from near by."""

    points: F64
    textured: NDArray[np.bool_]


def _coverage(cameras: Sequence[Camera], row: int, shown: _Shown | None) -> tuple[float, float, float]:
    """Shares of a camera's pixels that one and two others see well, and the median angle to the nearest, degrees."""
    if shown is None:
        return math.nan, math.nan, math.nan
    own = shown.points - camera_centre(cameras[row])
    angles = np.full((len(cameras), len(own)), np.inf)
    for other, camera in enumerate(cameras):
        if other == row:
            continue
        theirs = shown.points - camera_centre(camera)
        cosine = (own * theirs).sum(axis=1) / (np.linalg.norm(own, axis=1) * np.linalg.norm(theirs, axis=1))
        seen = in_picture(camera, *project(camera, shown.points))
        angles[other, seen] = np.arccos(np.clip(cosine[seen], -1, 1))
    # What has no texture looks alike from everywhere.
    count = (angles < np.where(shown.textured, MAX_RAYS_ANGLE, np.inf)).sum(axis=0)
    nearest = angles.min(axis=0)[shown.textured if shown.textured.any() else slice(None)]
    finite = nearest[np.isfinite(nearest)]
    gap = math.degrees(float(np.median(finite))) if len(finite) else math.nan
    return float((count >= 1).mean()), float((count >= 2).mean()), gap


def _matched_surface(cameras: Sequence[Camera], matches: Matches, row: int) -> _Shown | None:
    """What a grid of a camera's pixels shows, as deep as the triangulated match nearest to each; None without them."""
    pixels, depths = [np.empty((0, 2))], [np.empty(0)]
    for pair in matches.pairs:
        if row not in (pair.first, pair.second):
            continue
        points, good = triangulate(cameras[pair.first], cameras[pair.second], pair.first_rays, pair.second_rays)
        pixels.append((pair.first_pixels if row == pair.first else pair.second_pixels)[good])
        depths.append(project(cameras[row], points[good])[2])
    at, depth = np.concatenate(pixels), np.concatenate(depths)
    if len(at) < _MIN_DEPTH_POINTS:
        return None
    grid, rays = _grid_rays(cameras[row])
    behind = depth[np.argmin(((grid[:, None] - at[None]) ** 2).sum(axis=2), axis=1)]
    return _Shown(camera_centre(cameras[row]) + behind[:, None] * rays, np.ones(len(rays), bool))


def _stage_surface(stage: PlainStage, camera: Camera) -> _Shown:
    """What a grid of a camera's pixels shows of a plain stage: its hull, and the backdrop, which is plain."""
    _, rays = _grid_rays(camera)
    points = first_met(stage, camera_centre(camera), rays)
    return _Shown(points, ~stage.on_backdrop(points))


def _grid_rays(camera: Camera) -> tuple[F64, F64]:
    """A grid of a camera's pixels (N, 2), and their world directions (N, 3), at unit depth."""
    columns, rows = (
        (np.arange(n) + 0.5) / n * size for n, size in zip(_GRID_SIZE, (camera.width, camera.height), strict=True)
    )
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    x, y = ray_slopes(camera, grid[:, 0], grid[:, 1])
    return grid, turned(camera.world_to_camera[:3, :3].T, np.stack([x, y, np.ones_like(x)], axis=1))


def _or_none(value: float, specification: str, unit: str) -> str:
    return f"{value:{specification}}{unit}" if math.isfinite(value) else "-"
