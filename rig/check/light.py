"""A camera's own gain, separated from the scene's light by points that several cameras share.

The change at a point since the first frame is the sum of two: that of the light, the same for all cameras that see the
point, and that of a camera's exposure or white balance, the same for all its points. The difference between two cameras
at a point is independent of light. From many points, least absolute deviations give the cameras' gains, frame by frame,
up to a common gain, which counts as light. So the median of the cameras' gains is the scene's, and a camera's own gain
is its difference from this median.

A gain counts as far as at least 80 % of the camera's points share it, in one direction: gloss, shadows on one side,
motion and wrong matches differ from place to place. The camera's whole picture must confirm it: where most cameras'
pictures change alike, the median of its pixels must change by half of the gain more, in the same direction. This
excludes points on moving objects. A camera that shares too few points with others is undetermined.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, project
from decogs.formats.colours.srgb import linear_from_srgb

from ..stage.stage import PlainStage
from .matches import NEAR_LINE_PIXELS, Matches, PairMatches

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
I64 = NDArray[np.int64]

EXPOSURE_LIMIT = 0.03
"""Gain on linear light from which exposure counts as drifting: 3 levels of 255 in a bright picture, coded by a
power of 1/2.2."""

WHITE_BALANCE_LIMIT = 0.02
"""Least gain of red or blue against green that counts: one level of 255 at mid-grey."""

FRAME_LIMIT = 0.01
"""Gain from which a frame of a drifting camera counts: half a level at mid-grey; a median over many points."""

_POINT_WINDOW = np.mgrid[-4:5:2, -4:5:2].reshape(2, -1, 1)
"""Pixels around a point for averaging: reduces noise and the effect of half a pixel of misplacement."""
_MAX_CLIPPED_SHARE = 0.1
"""Largest clipped share of these."""
_MAX_PAIR_POINTS = 100
"""Most points of a pair of cameras: the median of so many has an eighth of the noise of one."""
_OUTLIER_SHARE = 0.2
"""Share of a camera's points at either end that may deviate."""
_MIN_CAMERA_POINTS = 20
"""Least points that a determined camera shares with others."""
_MIN_GAIN_ERRORS = 3.0
"""Least gain of a mismatched camera, in standard errors: matches across 20 degrees scatter by .15."""
_MIN_PAIR_POINTS = 5
"""Points of which a median stands for a pair of cameras."""
_GRID_ROWS = 24
"""Rows and columns of the grid of pixels that stands for a whole picture."""
_MIN_OVERALL_SHARE = 0.5
"""Least change of the median of a camera's pixels over its gain: a quarter of the pixels may deviate."""
_MIN_GROUP_CAMERAS = 3
"""Cameras that a median needs: of two that differ, either may drift."""
_LINEAR: F64 = linear_from_srgb(np.arange(256) / 255)
_CLIPPED_LEVELS = 5
"""Levels from either end of the scale within which a value is no measure of the light."""
_GAIN_REWEIGHTINGS = 12
_MIN_LOG_DEVIATION = 0.002
"""Deviation of a log ratio below which all weigh alike: a fifth of what noise does to the mean of a window."""


@dataclass(frozen=True)
class SharedPoints:
    """Points (N,) that two cameras see: positions ``first`` and ``second`` of the cameras, pixels (N, 2) in each."""

    first: I64
    second: I64
    first_pixels: F64
    second_pixels: F64

    def pixels_of(self, camera: int) -> F64:
        """A camera's pixels (M, 2) of its points, beginning with pairs in which it is the first."""
        return np.concatenate([self.first_pixels[self.first == camera], self.second_pixels[self.second == camera]])


@dataclass(frozen=True)
class Light:
    """The cameras' own gains against their first frames, without the scene's light; arrays (cameras, F).

    ``exposure``, ``white_balance``: sizes of the gain that 80 % of a camera's points share, as logarithms; NaN if
    undetermined. ``gains`` (cameras, F, 3): log gains over all channels, of red over green and of blue over green.
    """

    exposure: F64
    white_balance: F64
    gains: F64

    @property
    def drifts(self) -> NDArray[np.bool_]:
        """Which cameras (C,) drift."""
        return np.asarray(
            (_peaks(self.exposure) >= EXPOSURE_LIMIT) | (_peaks(self.white_balance) >= WHITE_BALANCE_LIMIT)
        )


@dataclass(frozen=True)
class Mismatch:
    """The cameras' gains against the median camera in the first frame, log, (cameras, 3) as those of `Light`.

    ``shares``: sizes of the gain that 80 % of a camera's points share; NaN if undetermined.
    """

    gains: F64
    shares: F64


def shared_points(cameras: Sequence[Camera], matches: Matches, stage: PlainStage | None = None) -> SharedPoints:
    """The matches that lie on each other's epipolar lines, and points of a ``stage``'s backdrop, which has none."""
    pairs = [_near_epipolar(cameras, pair) for pair in matches.pairs]
    if stage is not None:
        pairs += _on_backdrop(cameras, stage)
    if not pairs:
        return SharedPoints(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty((0, 2)))
    joined = [np.concatenate(parts) for parts in zip(*pairs, strict=True)]
    return SharedPoints(joined[0].astype(np.int64), joined[1].astype(np.int64), joined[2], joined[3])


def light_at(pictures: U8, pixels: F64) -> F64:
    """The colours of a camera's pictures (F, H, W, 3) at pixels (N, 2), as (F, N, 3) logarithms of linear light.

    Over all channels, of red over green, of blue over green. NaN next to black or white.
    """
    light = np.full((len(pictures), len(pixels), 3), np.nan)
    height, width = pictures.shape[1:3]
    row, column = (
        np.clip(np.floor(pixels[:, axis]).astype(np.int64) + shift, 0, size - 1)
        for axis, size, shift in ((1, height, _POINT_WINDOW[0]), (0, width, _POINT_WINDOW[1]))
    )
    pixel_numbers = row * width + column
    for index, picture in enumerate(pictures):
        around = picture.reshape(-1, 3).take(pixel_numbers, axis=0)
        # Below black, 8 bits go on from white: both ends are one comparison.
        ends = (around - np.uint8(_CLIPPED_LEVELS)) > 255 - 2 * _CLIPPED_LEVELS
        clipped = (ends[..., 0] | ends[..., 1] | ends[..., 2]).mean(axis=0)
        unclipped = clipped <= _MAX_CLIPPED_SHARE
        red, green, blue = np.log(_LINEAR.take(around).mean(axis=0)[unclipped]).T
        light[index, unclipped] = np.stack([(red + green + blue) / 3, red - green, blue - green], axis=1)
    return light


def light_overall(pictures: U8) -> F64:
    """The change of a camera's pictures (F, H, W, 3) against the first, medians (F, 3) of `light_at` a grid of pixels.

    NaN if hardly any pixel is determined.
    """
    height, width = pictures.shape[1:3]
    row, column = (
        np.linspace(0, size, _GRID_ROWS, endpoint=False) + size / (2 * _GRID_ROWS) for size in (height, width)
    )
    lights = light_at(pictures, np.stack(np.meshgrid(column, row), axis=-1).reshape(-1, 2))
    changes = lights - lights[:1]
    medians = np.full((len(changes), 3), np.nan)
    for frame, change in enumerate(changes):
        finite = change[np.isfinite(change).all(axis=1)]
        if len(finite) >= _MIN_CAMERA_POINTS:
            medians[frame] = np.median(finite, axis=0)
    return medians


def own_light(points: SharedPoints, lights: Sequence[F64], overall: Sequence[F64]) -> Light:
    """Every camera's own share of its changes.

    ``lights``: of each, `light_at` its `SharedPoints.pixels_of`; ``overall``: of each, `light_overall`.
    """
    changes = _differences(points, [light - light[:1] for light in lights])
    shape = len(lights), changes.shape[0], 3
    gains, shares = np.zeros(shape), np.full(shape, np.nan)
    shares[:, :1] = 0
    for frame in range(1, shape[1]):
        finite = np.isfinite(changes[frame]).all(axis=1)
        gains[:, frame], shares[:, frame], _ = _solved(
            points.first[finite], points.second[finite], changes[frame, finite], len(lights)
        )
    shares = _seen_overall(shares, np.stack(overall))
    exposure, balance = np.abs(shares[..., 0]), np.abs(shares[..., 1:3]).max(axis=2)
    nothing = np.isnan(shares[:, 1:, 0]).all(axis=1) if shape[1] > 1 else np.zeros(len(lights), bool)
    exposure[nothing], balance[nothing] = np.nan, np.nan
    return Light(exposure, balance, gains)


def mismatch(points: SharedPoints, lights: Sequence[F64]) -> Mismatch:
    """How the cameras' light differs at the points that they share, in the first frame.

    ``lights``: of each, `light_at` its `SharedPoints.pixels_of`. A gain counts that is beyond what the scatter of the
    camera's points, and that of pairs of cameras, explains.
    """
    differences = _differences(points, [light[:1] for light in lights])[0]
    finite = np.isfinite(differences).all(axis=1)
    first, second, differences = points.first[finite], points.second[finite], differences[finite]
    gains, shares, errors = _solved(first, second, differences, len(lights))
    errors = np.maximum(errors, _pair_errors(first, second, differences - gains[first] + gains[second], len(lights)))
    return Mismatch(gains, np.where(np.abs(shares) < _MIN_GAIN_ERRORS * errors, 0.0, shares))


def _seen_overall(shares: F64, overall: F64) -> F64:
    """The ``shares`` (cameras, F, 3) of gains, 0 where the cameras' ``overall`` changes contradict them.

    Overall changes that differ among most cameras, as under local light, do not count. A camera whose picture never
    changes overall has no gain: among drifting ones it has the opposite of the median's.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # No camera is determined in a frame.
        own = overall - np.nanmedian(overall, axis=0)
        usual = np.nanmedian(np.abs(own), axis=0)
        steady = np.nanmax(np.abs(overall), axis=1, keepdims=True) < FRAME_LIMIT
    needed = _MIN_OVERALL_SHARE * np.abs(shares)
    absent = (usual <= needed) & (own * np.sign(shares) < needed)
    return np.asarray(np.where(absent | (steady & np.isfinite(shares)), 0.0, shares))


def _near_epipolar(cameras: Sequence[Camera], pair: PairMatches) -> tuple[I64, I64, F64, F64]:
    near = np.flatnonzero(np.abs(pair.epipolar_distances(cameras)) < NEAR_LINE_PIXELS)
    near = near[:: math.ceil(len(near) / _MAX_PAIR_POINTS) or 1]
    numbers = [np.full(len(near), number, np.int64) for number in (pair.first, pair.second)]
    return numbers[0], numbers[1], pair.first_pixels[near], pair.second_pixels[near]


def _on_backdrop(cameras: Sequence[Camera], stage: PlainStage) -> list[tuple[I64, I64, F64, F64]]:
    """Points of the backdrop that two cameras show, of all pairs of them."""
    xyz, seen = stage.shared_points()
    pixels = [np.stack(project(camera, xyz)[:2], axis=1) for camera in cameras]
    pairs = []
    for one, two in combinations(range(len(cameras)), 2):
        both = np.flatnonzero(seen[one] & seen[two])
        both = both[:: math.ceil(len(both) / _MAX_PAIR_POINTS) or 1]
        first, second = (np.full(len(both), number, np.int64) for number in (one, two))
        pairs.append((first, second, pixels[one][both], pixels[two][both]))
    return pairs


def _differences(points: SharedPoints, values: Sequence[F64]) -> F64:
    """Difference of a point's values (F, N, 3) in its first and its second camera, from each camera's of its points."""
    frames = values[0].shape[0]
    sides = np.full((2, frames, len(points.first), 3), np.nan)
    for camera, own in enumerate(values):
        firsts = int((points.first == camera).sum())
        sides[0][:, points.first == camera], sides[1][:, points.second == camera] = own[:, :firsts], own[:, firsts:]
    return np.asarray(sides[0] - sides[1])


def _solved(first: I64, second: I64, differences: F64, cameras: int) -> tuple[F64, F64, F64]:
    """Gains (cameras, 3) that fit the points' ``differences`` (N, 3) best, the gain that 80 % of the points share, and
    the standard error of a median of a camera's points.

    Cameras without comparable ones have gain 0, share and error NaN.
    """
    gains = np.zeros((cameras, 3))
    shares, errors = np.full((2, cameras, 3), np.nan)
    for group in _comparable(first, second, cameras):
        inside = np.isin(first, group) & np.isin(second, group)
        a, b, own_differences = first[inside], second[inside], differences[inside]
        for column in range(3):
            solved = _least_deviations(
                np.searchsorted(group, a), np.searchsorted(group, b), own_differences[:, column], len(group)
            )
            gains[group, column] = solved - np.median(solved)
        for camera in group:
            as_first, as_second = a == camera, b == camera
            own = np.concatenate(
                [own_differences[as_first] + gains[b[as_first]], gains[a[as_second]] - own_differences[as_second]]
            )
            shares[camera] = _shared(own)
            deviation = 1.48 * np.median(np.abs(own - np.median(own, axis=0)), axis=0)
            errors[camera] = 1.25 * deviation / math.sqrt(len(own))
    return gains, shares, errors


def _pair_errors(first: I64, second: I64, left: F64, cameras: int) -> F64:
    """Standard errors (cameras, 3) of gains, from what they leave of the points' differences, ``left`` (N, 3).

    Shading that depends on the view, and misplacement, are shared by the points of a pair of cameras: each pair is one
    observation. 0 where no pair is more than the gains need.
    """
    pairs, inverse, counts = np.unique(first * cameras + second, return_inverse=True, return_counts=True)
    kept = np.flatnonzero(counts >= _MIN_PAIR_POINTS)
    one, two = np.divmod(pairs[kept], cameras)
    signs = np.eye(cameras)[one] - np.eye(cameras)[two]
    spare = len(kept) - np.linalg.matrix_rank(signs) if len(kept) else 0
    if not spare:
        return np.zeros((cameras, 3))
    medians = np.stack([np.median(left[inverse == pair], axis=0) for pair in kept])
    weighted = signs.T * counts[kept]
    fit = np.linalg.pinv(weighted @ signs) @ weighted
    return np.asarray(np.sqrt((fit**2).sum(axis=1)[:, None] * (medians**2).sum(axis=0) / spare))


def _comparable(first: I64, second: I64, cameras: int) -> list[I64]:
    """Groups of cameras, ascending, with enough common points."""
    kept = np.ones(cameras, bool)
    while True:
        both = kept[first] & kept[second]
        counts = np.bincount(first[both], minlength=cameras) + np.bincount(second[both], minlength=cameras)
        enough = kept & (counts >= _MIN_CAMERA_POINTS)
        if (enough == kept).all():
            break
        kept = enough
    group = np.arange(cameras)
    for _ in range(cameras):
        lower = group.copy()
        np.minimum.at(lower, first[both], group[second[both]])
        np.minimum.at(lower, second[both], group[first[both]])
        if (lower == group).all():
            break
        group = lower
    groups = [np.flatnonzero(kept & (group == number)) for number in np.unique(group[kept])]
    return [members for members in groups if len(members) >= _MIN_GROUP_CAMERAS]


def _least_deviations(first: I64, second: I64, differences: F64, cameras: int) -> F64:
    """Gains (cameras,) with least absolute deviations from ``differences`` (N,), first minus second."""
    weights = np.ones(len(differences))
    gains = np.zeros(cameras)
    for _ in range(_GAIN_REWEIGHTINGS):
        coupling = np.bincount(first * cameras + second, weights, cameras**2).reshape(cameras, cameras)
        coupling += coupling.T
        normal = np.diag(coupling.sum(axis=1)) - coupling
        pulled = weights * differences
        right = np.bincount(first, pulled, cameras) - np.bincount(second, pulled, cameras)
        # The common gain is arbitrary; this makes the mean 0.
        gains = np.linalg.solve(normal + np.trace(normal) / cameras**2, right)
        weights = 1 / np.maximum(np.abs(differences - gains[first] + gains[second]), _MIN_LOG_DEVIATION)
    return gains


def _shared(values: F64) -> F64:
    """Value that at least 80 % of the points (N, ...) reach in one direction; 0 if they differ in sign."""
    low, high = np.quantile(values, [_OUTLIER_SHARE, 1 - _OUTLIER_SHARE], axis=0)
    nearer = np.where(np.abs(low) < np.abs(high), low, high)
    return np.asarray(np.where(low * high > 0, nearer, 0.0))


def _peaks(values: F64) -> F64:
    return np.asarray(np.nan_to_num(values, nan=0.0).max(axis=1))
