"""Whether a camera's pose fits its calibration: by points that other cameras triangulate.

A point that two other cameras triangulate must fall on its own match in the camera's picture. One match alone proves
nothing; an offset that many share is the camera's fault. Distances from epipolar lines do not suffice: in a row of
cameras they hardly change when one of them turns along the row.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, in_camera, turned

from ..numerics import tukey
from .matches import NEAR_LINE_PIXELS, Matches, PairMatches, epipolar_distances

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

MIN_RAYS_ANGLE, MAX_RAYS_ANGLE = math.radians(2), math.radians(50)
"""Angles, radians, between two rays that place a point: below, depth is uncertain; above, surfaces look different."""
_TURNED_DEGREES = 0.7
"""Degrees from which a camera counts as turned (a good one of `stage` whose neighbour is late has .65) ..."""
_TURNED_PIXELS = 2.5
"""... if they are so many pixels: matches are not exact."""
_MIN_TURN_MATCHES = 12
"""Matches that a judgement needs."""
_MIN_PAIR_MATCHES = 20
"""Matches of a pair of cameras from which its epipolar lines are estimated."""
_MIN_CAMERAS = 4
"""Of three that disagree, any may be the one."""
_MAX_OFFSET = 0.12
"""Largest offset of a right match, in focal lengths: seven degrees."""
_LAST_REACH = 0.003
"""Reach of the last rounds' weights, in focal lengths: about a pixel."""
_TURN_ROUNDS = 16
_MAX_RESIDUAL_SHARE = 0.35
"""Largest median of what a turn leaves of the offsets, in shares of the turn."""
_MIN_MOVED_ERRORS = 5.0
"""Least median of how far a turn moves the matches, in standard errors of what it leaves: 4 for a false one."""
_MAX_LINE_DISTANCE_PIXELS = 15.0
"""Largest distance of a right match from its line, in pixels: a camera turned by three degrees."""
_NEAREST_MATCHES_SHARE = 0.3
ON_LINE_PIXELS = 1.5
"""Distance from its epipolar line within which a match fits: five deviations of SIFT's."""
_LEFT_ON_LINES = 0.9
"""Matches that a true turn leaves on their lines, at least; along a row of cameras it puts none there."""
_SAMPLES = 3000
"""Of three matches: where a quarter is right, 45 have no wrong one."""
_SMALL_TURN = 1e-4


@dataclass(frozen=True)
class _Seen:
    """A camera's matched features: pixels (N, 2), rays x/z and y/z (N, 2)."""

    pixels: F64
    rays: F64


def turns(cameras: Sequence[Camera], matches: Matches, wrong: Collection[int] = ()) -> F64:
    """Rotation (cameras,) of each camera against its calibration, in degrees; NaN if undetermined.

    A camera that is moved seems turned. One without which the others agree is excluded before they are judged, as are
    those that are known to be ``wrong``.
    """
    left = set(range(len(cameras))) - set(wrong)
    misplaced = _turns(cameras, matches, left, wrong)
    by_camera = _turns(cameras, matches, left)
    while len(left) > _MIN_CAMERAS:
        suspects = [camera for camera in sorted(left) if is_turned(cameras[camera], by_camera.get(camera, math.nan))]
        if not suspects:
            break
        without = {camera: _turns(cameras, matches, left - {camera}) for camera in suspects}
        worst = min(suspects, key=lambda camera: sum(without[camera].values()))
        left.remove(worst)
        misplaced[worst], by_camera = by_camera[worst], without[worst]
    by_camera |= misplaced
    return np.array([by_camera.get(camera, np.nan) for camera in range(len(cameras))])


def _turns(
    cameras: Sequence[Camera], matches: Matches, left: set[int], of: Collection[int] | None = None
) -> dict[int, float]:
    """The turns of the cameras ``left``, or ``of`` others, judged by those left; without what is undetermined."""
    judged = sorted(left if of is None else of)
    turns = {camera: _turn(cameras, matches, camera, left - {camera}) for camera in judged}
    return {camera: turn for camera, turn in turns.items() if not math.isnan(turn)}


def is_turned(camera: Camera, turn: float) -> bool:
    """Whether a turn, in degrees, counts; NaN does not."""
    return turn >= max(_TURNED_DEGREES, math.degrees(_TURNED_PIXELS / camera.fx))


def epipolar_residuals(cameras: Sequence[Camera], matches: Matches) -> F64:
    """Distance (cameras,) of matches from their epipolar lines in a camera's best pair, in pixels; NaN without matches.

    Wrong matches lie anywhere: of those that could be right, the nearer third decides.
    """
    residuals = np.full(len(cameras), np.nan)
    for pair in matches.pairs:
        distances = np.abs(pair.epipolar_distances(cameras))
        possible = distances[distances < _MAX_LINE_DISTANCE_PIXELS]
        if len(possible) >= _MIN_PAIR_MATCHES:
            for camera in (pair.first, pair.second):
                residuals[camera] = np.fmin(residuals[camera], float(np.quantile(possible, _NEAREST_MATCHES_SHARE)))
    return residuals


def reprojections(cameras: Sequence[Camera], matches: Matches, camera: int, others: set[int]) -> tuple[F64, F64]:
    """A camera's matched rays x/z, y/z (N, 2), and how far (N, 2) from them lie the points that others triangulate."""
    pairs = {other: pair for pair in matches.pairs for other in _partner(pair, camera) if other in others}
    rays, offsets = [np.empty((0, 2))], [np.empty((0, 2))]
    for one, two in combinations(sorted(pairs), 2):
        rows_one, rows_two = _in_both(_own(pairs[one], camera), _own(pairs[two], camera))
        rays_one, rays_two = _own(pairs[one], one).rays[rows_one], _own(pairs[two], two).rays[rows_two]
        points, good = triangulate(cameras[one], cameras[two], rays_one, rays_two)
        x, y, depth = np.moveaxis(in_camera(cameras[camera], points), -1, 0)
        good &= depth > 0
        seen = np.stack([x[good], y[good]], axis=1) / depth[good, None]
        own = _own(pairs[one], camera).rays[rows_one][good]
        possible = np.abs(own - seen).max(axis=1) < _MAX_OFFSET
        rays.append(own[possible])
        offsets.append((own - seen)[possible])
    return np.concatenate(rays), np.concatenate(offsets)


def triangulate(one: Camera, two: Camera, rays_one: F64, rays_two: F64) -> tuple[F64, NDArray[np.bool_]]:
    """Points (N, 3) nearest to pairs of rays x/z, y/z (N, 2), and whether they are reliable.

    A point is the middle of the shortest segment between its rays. It is reliable if that lies in front of both
    cameras, on the epipolar line, and the angle between the rays determines the depth.
    """
    centres = camera_centre(one), camera_centre(two)
    rays = [
        turned(camera.world_to_camera[:3, :3].T, np.concatenate([seen, np.ones((len(seen), 1))], axis=1))
        for camera, seen in ((one, rays_one), (two, rays_two))
    ]
    a, b = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    baseline = centres[1] - centres[0]
    cosine = (a * b).sum(axis=1)
    sine_squared = np.maximum(1 - cosine**2, 1e-12)
    along_a, along_b = (a * baseline).sum(axis=1), (b * baseline).sum(axis=1)
    reach_a = (along_a - cosine * along_b) / sine_squared
    reach_b = (cosine * along_a - along_b) / sine_squared
    points = (centres[0] + reach_a[:, None] * a + centres[1] + reach_b[:, None] * b) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    near = np.abs(epipolar_distances(one, two, rays_one, rays_two)) < NEAR_LINE_PIXELS
    good = near & (reach_a > 0) & (reach_b > 0) & (angle > MIN_RAYS_ANGLE) & (angle < MAX_RAYS_ANGLE)
    return points, good


def _turn(cameras: Sequence[Camera], matches: Matches, camera: int, others: set[int]) -> float:
    """The rotation that explains most offsets, in degrees: a camera's turn by w moves a ray r by -w x r."""
    rays, offsets = reprojections(cameras, matches, camera, others)
    if len(rays) < _MIN_TURN_MATCHES:
        return math.nan
    x, y = rays.T
    rows = np.stack([[x * y, -1 - x * x, y], [1 + y * y, -x * y, -x]], axis=0).transpose(2, 0, 1)
    turn, reach = np.zeros(3), _MAX_OFFSET
    for _ in range(_TURN_ROUNDS):
        missed = offsets - rows @ turn
        weight = tukey(np.linalg.norm(missed, axis=1), reach)[:, None, None]
        normal = np.einsum("nij,nik->jk", rows * weight, rows) + 1e-9 * np.eye(3)
        turn = np.linalg.solve(normal, np.einsum("nij,ni->j", rows * weight, offsets))
        reach = max(0.7 * reach, _LAST_REACH)
    size = float(np.linalg.norm(turn))
    missed, moved = (float(np.median(np.linalg.norm(each, axis=1))) for each in (offsets - rows @ turn, rows @ turn))
    # A turn that leaves most offsets as they were is the mean of wrong matches; one that moves the few matches of a
    # single performer by no more than their errors is a roll about the place where they are. What few points explain
    # must not take matches off their lines.
    explains = missed < min(_MAX_RESIDUAL_SHARE * size, moved * math.sqrt(len(rays)) / _MIN_MOVED_ERRORS)
    lines = Lines.of(cameras, matches, camera, others)
    given, with_turn = lines.count_on(np.zeros(3)), lines.count_on(-turn)
    explains &= with_turn >= _LEFT_ON_LINES * given
    return math.degrees(size) if explains or not is_turned(cameras[camera], math.degrees(size)) else math.nan


@dataclass(frozen=True)
class Lines:
    """A camera's matches (N,) with others, and their distances from the others' epipolar lines, in pixels.

    ``pairs``: the other camera, own rays x/z, y/z (n, 2), and the other's.
    """

    camera: Camera
    pairs: Sequence[tuple[Camera, F64, F64]]

    @staticmethod
    def of(cameras: Sequence[Camera], matches: Matches, camera: int, others: set[int]) -> Lines:
        """The matches of one of the ``cameras`` with ``others``."""
        partners = [(pair, other) for pair in matches.pairs for other in _partner(pair, camera) if other in others]
        pairs = [(cameras[other], _own(pair, camera).rays, _own(pair, other).rays) for pair, other in partners]
        return Lines(cameras[camera], pairs)

    def __len__(self) -> int:
        return sum(len(own) for _, own, _ in self.pairs)

    def distances(self, turn: F64) -> F64:
        """Signed distances (N,) if the camera were turned by ``turn`` (3,), radians, against its calibration."""
        pose = self.camera.world_to_camera.copy()
        pose[:3] = cv2.Rodrigues(np.asarray(turn, np.float64))[0] @ pose[:3]
        here = replace(self.camera, world_to_camera=pose)
        return np.concatenate([np.empty(0), *(epipolar_distances(here, *pair) for pair in self.pairs)])

    def count_on(self, turn: F64) -> int:
        """How many lie on their lines."""
        return int((np.abs(self.distances(turn)) < ON_LINE_PIXELS).sum())

    def turn(self) -> F64 | None:
        """The turn (3,), radians, that puts most matches on their lines, though most may be wrong; None if too few.

        Random sample consensus of three matches each (Fischler and Bolles 1981), then least squares.
        """
        if len(self) < _MIN_PAIR_MATCHES:
            return None
        at = self.distances(np.zeros(3))
        slopes = np.stack([(self.distances(_SMALL_TURN * axis) - at) / _SMALL_TURN for axis in np.eye(3)], axis=1)
        chosen = np.random.default_rng(0).integers(0, len(at), (_SAMPLES, 3))
        sure = np.abs(np.linalg.det(slopes[chosen])) > 1e-6 * np.abs(slopes).mean() ** 3
        tried = -np.linalg.solve(slopes[chosen[sure]], at[chosen[sure], None])[..., 0]
        tried = tried[np.linalg.norm(tried, axis=1) < _MAX_OFFSET]
        if not len(tried):
            return None
        best = tried[np.argmax((np.abs(at + tried @ slopes.T) < ON_LINE_PIXELS).sum(axis=1))]
        for _ in range(_TURN_ROUNDS):
            near = np.abs(at + slopes @ best) < ON_LINE_PIXELS
            best = -np.linalg.lstsq(slopes[near], at[near], rcond=None)[0]
        return np.asarray(best)


def _partner(pair: PairMatches, camera: int) -> Iterator[int]:
    if camera in (pair.first, pair.second):
        yield pair.first + pair.second - camera


def _own(pair: PairMatches, camera: int) -> _Seen:
    if camera == pair.first:
        return _Seen(pair.first_pixels, pair.first_rays)
    return _Seen(pair.second_pixels, pair.second_rays)


def _in_both(one: _Seen, two: _Seen) -> tuple[I64, I64]:
    """Rows of the features that both have: the same pixels of one picture."""
    first, second = (np.ascontiguousarray(seen.pixels).view(np.complex128).ravel() for seen in (one, two))
    _, rows_one, rows_two = np.intersect1d(first, second, return_indices=True)
    return np.asarray(rows_one, np.int64), np.asarray(rows_two, np.int64)
