"""What to expect of a rig before it is encoded: overlap of its cameras, pose errors, delays."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, in_picture, project, ray_directions

from ..parallel import Each
from ..stage.stage import PlainStage
from ..synchronisation.starts import frames_late
from .faults import HARMFUL, LATE, SWAPPED, Fault, Findings, faults_of, verdict_on
from .light import Mismatch
from .matches import Matches, features_of, join_matches, match_features
from .poses import connections, find_swaps, judge_poses, moments_of
from .recordings import sharpness
from .reprojection import MAX_RAYS_ANGLE, triangulate, turns
from .rig_statistics import RigStatistics, typical_noise
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
_CONNECTED_SHARE = 0.8
"""Least share of a dense rig's cameras that have matches with two others: `mouse_cage` has .75."""
DENSE = "dense"
_DENSE_GAP = 16.0
"""Largest median angle, degrees, to the nearest camera in a dense rig."""
_PSNR = {DENSE: (30, 35), RIGHT: (20, 34), ROUGH: (20, 34), WRONG: (9, 25)}
"""PSNR, dB, of whole pictures of cameras left out. Eight dense rigs have 30.2 to 34.8; of others `mouse_cage` 20.5,
`stage` 21.9, `green` 32.4; `desk`, `balance` and `assembly_table` 8.7 to 15.7, stages of four to eight cameras 16.8 to
25.7 (report/rigs.md, DESIGN.md)."""
_BASIS = "whole pictures of cameras left out, preset standard, on the 13 rigs measured: a class, no forecast"
_COLUMNS = 80
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
    behind the others; NaN where too little moves. ``connected``: the cameras that it has matches with, and how many lie
    on their lines. ``trouble``: words for its ``faults``; ``verdict``: GOOD, USABLE or HARMFUL.
    """

    camera: str
    seen_by_one: float
    seen_by_two: float
    gap: float
    residual: float
    turned: float
    late: float
    misplaced: bool
    connected: Mapping[str, int]
    sharpness: float
    noise: float
    stops: float
    trouble: tuple[str, ...]
    verdict: str
    faults: tuple[Fault, ...]

    def cells(self) -> Iterator[str]:
        """The figures of the camera's row in the table."""
        figures = (
            (self.seen_by_one, 9, ".0%", ""),
            (self.seen_by_two, 5, ".0%", ""),
            (self.gap, 7, ".0f", " deg"),
            (sum(self.connected.values()) or math.nan, 7, ".0f", ""),
            (self.residual, 7, ".2f", " px"),
            (self.turned, 8, ".2f", " deg"),
            (self.late, 4, ".2g", ""),
        )
        for value, width, as_text, unit in figures:
            yield f"{_or_none(value, as_text, unit):>{width}}"

    def judgement(self) -> str:
        """The verdict, with the first fault; the others are in the warnings."""
        more = f" +{len(self.trouble) - 1}" if len(self.trouble) > 1 else ""
        return f"{self.verdict}: {self.trouble[0]}{more}" if self.trouble else self.verdict

    def to_json(self) -> dict[str, Any]:
        """Its figures and words; NaN where nothing is known."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "faults"} | {
            "reasons": [str(fault) for fault in self.faults]
        }


@dataclass(frozen=True)
class RigCheck:
    """The cameras, and what to expect: RIGHT, ROUGH or WRONG; None for fewer than three cameras."""

    cameras: tuple[CameraCheck, ...]
    expected: str | None

    def warnings(self) -> Iterator[str]:
        """What the user should know before encoding, one line each."""
        for camera in self.cameras:
            yield from (str(fault) for fault in camera.faults)
        if self.expected == WRONG:
            yield f"{_EXPECTATIONS[WRONG]}: {self._why()}; add cameras in between"

    @property
    def psnr(self) -> tuple[int, int] | None:
        """What new views between the cameras had, dB, on the rigs that are known to be alike; None where none is."""
        if self.expected is None:
            return None
        is_dense = self.expected == RIGHT and self._connected() and self._gap() <= _DENSE_GAP
        return _PSNR[DENSE if is_dense else self.expected]

    @property
    def harmful(self) -> tuple[str, ...]:
        """The cameras that are better left out."""
        return tuple(camera.camera for camera in self.cameras if camera.verdict == HARMFUL)

    def advice(self) -> str:
        """What would help most, in a line; empty where nothing would."""
        swapped = [camera.camera for camera in self.cameras if SWAPPED in camera.trouble]
        if swapped:
            return f"exchange the files of {' and '.join(swapped[:2])}, and look again"
        if any(LATE in camera.trouble for camera in self.cameras):
            return "put the cameras in step (decogs-sync, or encode with --sync auto), and look again"
        if self.harmful:
            options = " ".join(f"--exclude {name}" for name in self.harmful)
            return f"mend {', '.join(self.harmful)}, or leave out what does harm: {options}"
        gaps = [camera for camera in self.cameras if math.isfinite(camera.gap)]
        if self.expected in (ROUGH, WRONG):
            widest = max(gaps, key=lambda camera: camera.gap).camera if gaps else self.cameras[0].camera
            return f"more cameras in between, first beside {widest}"
        alone = [camera.camera for camera in self.cameras if not camera.connected]
        if alone and self.expected is not None:
            return f"a camera beside {alone[0]}, whose pictures no other matches"
        return ""

    def summary(self) -> Iterator[str]:
        """What to expect, from what, and what would help, a sentence each."""
        if self.expected is not None and self.psnr is not None:
            yield f"{_EXPECTATIONS[self.expected]}: {self._why()}"
            yield f"expected of new views: {self.psnr[0]} to {self.psnr[1]} dB ({_BASIS})"
        if self.advice():
            yield f"what would help most: {self.advice()}"

    def table(self) -> Iterator[str]:
        """For the user: the verdict, and a row per camera."""
        for sentence in self.summary():
            yield from in_columns(sentence)
        width = max(6, *(len(each.camera) for each in self.cameras), 6)
        yield (f"{'camera':<{width}}  seen by: 1     2 nearest matches  off by   turned late  verdict")
        for each in self.cameras:
            yield " ".join([f"{each.camera:<{width}} ", *each.cells(), "", each.judgement()])

    def _gap(self) -> float:
        gaps = [camera.gap for camera in self.cameras if math.isfinite(camera.gap)]
        return float(np.median(gaps)) if gaps else math.inf

    def _connected(self) -> bool:
        """Whether nearly all cameras have matches with two others, which place what they see."""
        return sum(len(camera.connected) >= 2 for camera in self.cameras) >= _CONNECTED_SHARE * len(self.cameras)

    def _why(self) -> str:
        shares = [_share_or_zero(each.seen_by_two) for each in self.cameras]
        gaps = [each.gap for each in self.cameras if math.isfinite(each.gap)]
        near = f"; the nearest view is {np.median(gaps):.0f} degrees away" if gaps else ""
        return f"two other cameras see {np.median(shares):.0%} of a camera's pixels{near} (medians)"


def in_columns(sentence: str) -> list[str]:
    """A sentence in lines of a terminal, those after the first indented."""
    return textwrap.wrap(sentence, _COLUMNS, subsequent_indent="    ", break_on_hyphens=False, break_long_words=False)


def check_rig(stats: RigStatistics, each: Each) -> RigCheck:
    """Judges a rig by its calibration, the matches of its pictures, those of what moves, and the pictures."""
    noise = typical_noise(stats.noise)
    late = stats.step * frames_late(stats.cameras, stats.pictures, each)
    findings = [
        Findings(
            name,
            lost=[stats.frames[k] for k in np.flatnonzero(stats.recordings.dead(row))],
            hung=[stats.frames[k] for k in np.flatnonzero(stats.recordings.hung(row))],
            dropped=[stats.frames[k] for k in np.flatnonzero(stats.recordings.dropped(row))],
            unread=[stats.frames[k] for k in np.flatnonzero(stats.recordings.unread[row])],
            damage=stats.damage.get(name, ""),
            sharpness=float(sharp),
            noise=float(noise[row]),
            usual_noise=float(np.median(noise)),
            stops=float(stops),
            moving=stats.moving[row],
        )
        for row, (name, sharp, stops) in enumerate(
            zip(stats.names, _least(sharpness(stats.details, noise)), _stops(stats.mismatch), strict=True)
        )
    ]
    matches, swaps = _matches_in_place(stats, late, each)
    if swaps:  # Light was compared at points that the exchanged pictures do not share.
        findings = [replace(own, stops=math.nan) for own in findings]
    first = matches if swaps else stats.matches
    return judge_rig(stats.cameras, first, late, stats.stage, pooled=matches, findings=findings, swaps=swaps)


def judge_rig(
    cameras: Sequence[Camera],
    matches: Matches,
    late: F64,
    stage: PlainStage | None = None,
    *,
    pooled: Matches | None = None,
    findings: Sequence[Findings] | None = None,
    swaps: Sequence[tuple[int, int]] = (),
) -> RigCheck:
    """The check by the matches of the cameras' first pictures; ``late`` (cameras,) in frames, NaN where unknown.

    ``pooled``: matches of more moments, by which poses are judged.

    On a plain ``stage``, whose backdrop has no matches, its surfaces and hull say what the cameras see. ``findings``:
    what the pictures tell. ``swaps``: cameras with each other's pictures, whose ``matches`` are in place.
    """
    poses = judge_poses(cameras, matches if pooled is None else pooled)
    connected = connections(cameras, matches)
    other = {row: cameras[pair[1 - k]].name for pair in swaps for k, row in enumerate(pair)}
    checks = []
    for row, camera in enumerate(cameras):
        shown = _matched_surface(cameras, matches, row) if stage is None else _stage_surface(stage, camera)
        by_one, by_two, gap = _coverage(cameras, row, shown)
        own = replace(
            Findings(camera.name) if findings is None else findings[row],
            swapped=other.get(row),
            misplaced=bool(poses.misplaced[row]),
            turned=float(poses.turned[row]),
            residual=float(poses.residuals[row]),
            late=float(late[row]),
            matched=bool(connected[row]),
        )
        faults = tuple(faults_of(own))
        checks.append(
            CameraCheck(
                camera.name,
                seen_by_one=by_one,
                seen_by_two=by_two,
                gap=gap,
                residual=own.residual,
                turned=own.turned,
                late=own.late,
                misplaced=own.misplaced,
                connected={cameras[k].name: count for k, count in sorted(connected[row].items())},
                sharpness=own.sharpness,
                noise=own.noise,
                stops=own.stops,
                trouble=tuple(fault.word for fault in faults),
                verdict=verdict_on(faults),
                faults=faults,
            )
        )
    return RigCheck(tuple(checks), _expected(checks))


def _matches_in_place(stats: RigStatistics, late: F64, each: Each) -> tuple[Matches, list[tuple[int, int]]]:
    """Matches that suffice to judge poses, with exchanged pictures in their places, and which these are.

    Of a late camera, by the frames that show the others' moments.
    """
    shift = np.rint(np.nan_to_num(late) / stats.step).astype(int)
    frames = len(stats.frames)
    begin, end = max(0, -shift.min()), frames - max(0, shift.max())
    moments = [begin + k for k in moments_of(end - begin)] if end > begin else [0]
    undecided = np.isnan(turns(stats.cameras, stats.matches)).any() or shift.any()
    if not undecided:
        return stats.matches, []
    rows = range(len(stats.cameras))
    features = [
        list(each(features_of, stats.cameras, [stats.pictures[k][np.clip(at + shift[k], 0, frames - 1)] for k in rows]))
        for at in moments
    ]
    matches = join_matches([match_features(stats.cameras, seen, each) for seen in features])
    swaps, in_place = find_swaps(stats.cameras, features, matches)
    return in_place, swaps


def _stops(light: Mismatch) -> F64:
    """Each camera's exposure (cameras,) against the median camera, in stops, as far as its points share it."""
    return np.asarray(np.where(light.shares[:, 0] != 0, light.gains[:, 0], 0.0) / math.log(2))


def _least(sharp: F64) -> F64:
    """The smaller of a camera's ratios (cameras, n); NaN where none is known."""
    return np.asarray(np.fmin.reduce(sharp, axis=1))


def _expected(checks: Sequence[CameraCheck]) -> str | None:
    if len(checks) < 3:
        return None
    seen = float(np.median([_share_or_zero(check.seen_by_two) for check in checks]))
    gaps = [check.gap for check in checks if math.isfinite(check.gap)]
    gap = math.radians(float(np.median(gaps))) if len(gaps) * 2 > len(checks) else math.inf
    if seen >= _RIGHT_SEEN_SHARE and gap <= _RIGHT_GAP:
        return RIGHT
    return ROUGH if seen >= _ROUGH_SEEN_SHARE and gap <= _ROUGH_GAP else WRONG


def _share_or_zero(share: float) -> float:
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
    return grid, ray_directions(camera, grid[:, 0], grid[:, 1])


def _or_none(value: float, specification: str, unit: str) -> str:
    return f"{value:{specification}}{unit}" if math.isfinite(value) else "-"
