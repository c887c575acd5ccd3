"""Lens distortion: by the rig's calibration, or, beyond it, by matches between neighbouring cameras.

Without distortion, a point in two pictures lies on its epipolar line in each. The fit has one coefficient k1 per camera
(OpenCV's: distorted = undistorted (1 + k1 r^2)) and a small rotation per camera, so that errors of the pose are not
distortion. Gauss-Newton minimises Sampson distances of all matches, with Tukey weights whose reach shrinks to four
deviations, since a third of the matches may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import distort_pixels
from decogs.formats.cameras import Camera, camera_centre, is_distorted
from decogs.rig.check.matches import PairMatches, essential_matrices, sampson_distances
from decogs.rig.check.rig_statistics import RigStatistics
from decogs.rig.numerics import tukey

from ..change.masks import BoolArray
from ..settings.encode import EncodeSettings
from .effect import F64, Decision, Evidence, cameras_beyond, make_decision, reason_of

_LIMIT_PIXELS = 1.0
"""Least displacement that counts, in pixels of the analysed size: three times SIFT's accuracy. Beyond the calibration,
it is that at the radius within which nine of ten matches lie: the fit has no data farther out."""
_RADIUS_QUANTILE = 0.9
_BOUND_DEVIATIONS = 3.0
"""Deviations of the fit, subtracted from its result for a lower bound of the distortion."""
_MIN_CAMERA_MATCHES = 100
"""Fewer lie near the middle of the picture, on one subject; a tenth of them are wrong alike: `green` has 30 to 60."""
_MIN_INLIER_SHARE = 0.5
"""Least share of a camera's matches near their epipolar lines after the fit; by chance one in ten wrong matches is."""
_UNKNOWNS_PER_CAMERA = 4
_GAUSS_NEWTON_STEPS = 12
_FIRST_REACH_PIXELS, _REACH_DECAY = 20.0, 0.7
_MIN_DEVIATION_PIXELS = 0.3
"""SIFT's accuracy, in pixels."""
_ROTATION_PRIOR = np.radians(0.15)
_K1_PRIOR = 0.3
_DERIVATIVE_STEP = 1e-5


class LensDistortion:
    """Lenses with distortion beyond their calibration."""

    name = "lens_distortion"

    def evidence(self, stats: RigStatistics) -> Evidence:
        beyond, error, k1 = _beyond_calibration(stats)
        calibrated = np.array([_calibrated(camera) for camera in stats.cameras])
        values = np.full((len(stats.cameras), len(stats.frames)), np.nan)
        # Undetermined counts for a lens that is calibrated; a calibrated zero is no evidence where the fit is
        # undetermined.
        values[:, 0] = np.fmax(_surely(beyond, error), np.where(calibrated > 0, calibrated, np.nan))
        details = {"k1": k1, "beyond_px": beyond, "deviation_px": error, "calibrated_px": calibrated}
        return Evidence(values, "px", _LIMIT_PIXELS, {name: column[:, None] for name, column in details.items()})

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        details = {name: column[:, 0] for name, column in evidence.details.items()}
        uncalibrated = np.nan_to_num(_surely(details["beyond_px"], details["deviation_px"])) >= evidence.limit
        return make_decision(
            stats,
            self,
            evidence,
            counts=cameras_beyond(evidence),
            reason=reason_of(
                evidence, _reason(stats, evidence, uncalibrated), "too few points are seen by two cameras"
            ),
            cost="resampling of every picture, 2 ms at 352x264 (estimated); only the lens is coded",
            figures={"k1": {stats.names[k]: float(details["k1"][k]) for k in np.flatnonzero(uncalibrated)}},
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        """Corrects the distortion beyond the calibration, which is undone in any case."""
        return replace(settings, corrections=replace(settings.corrections, lens=dict(decision.figures["k1"])))

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return replace(settings, corrections=replace(settings.corrections, lens={}))


def _surely(pixels: F64, deviation: F64) -> F64:
    return np.asarray(np.maximum(np.abs(pixels) - _BOUND_DEVIATIONS * deviation, 0.0))


def _reason(stats: RigStatistics, evidence: Evidence, uncalibrated: BoolArray) -> str:
    text = f"a lens displaces pixels by up to {evidence.peak:.1f} px"
    if uncalibrated.any():
        k1 = evidence.details["k1"][:, 0]
        named = ", ".join(f"{stats.names[k]} k1 {k1[k]:+.3f}" for k in np.flatnonzero(uncalibrated))
        return f"{text}; the calibration misses {named}"
    return f"{text}, as calibrated" if cameras_beyond(evidence).any() else text


def _calibrated(camera: Camera) -> float:
    """Displacement of the calibrated lens near a corner, at the last pixel it reaches; 0 without distortion."""
    if not is_distorted(camera):
        return 0.0
    share = np.linspace(0, 1, 33)[:, None]
    corner = np.array([camera.width, camera.height], np.float64)
    centre = np.array([camera.cx, camera.cy])
    straight = np.concatenate([centre + share * (end - centre) for end in (0 * corner, corner)])
    moved = np.linalg.norm(distort_pixels(camera, straight) - straight, axis=1)
    return float(moved[np.isfinite(moved)].max())


def _beyond_calibration(stats: RigStatistics) -> tuple[F64, F64, F64]:
    """Displacement by each camera's k1 beyond its calibration, its deviation (pixels), and k1; NaN: undetermined."""
    count = len(stats.cameras)
    beyond, error, k1 = (np.full(count, np.nan) for _ in range(3))
    fit = _Fit(stats.cameras, stats.matches.pairs)
    met = fit.matches_of_cameras()
    if met.max(initial=0) < _MIN_CAMERA_MATCHES:
        return beyond, error, k1
    estimate, deviation = fit.solve()
    kept = fit.matches_of_cameras()
    is_reliable = (kept >= _MIN_CAMERA_MATCHES) & (kept >= _MIN_INLIER_SHARE * met)
    radii = fit.radii()
    fisheye = [camera.distortion_model == "fisheye" for camera in stats.cameras]
    pixels = np.array([camera.fx for camera in stats.cameras]) * np.where(fisheye, np.arctan(radii), radii) ** 3
    beyond[is_reliable], error[is_reliable], k1[is_reliable] = (
        (estimate * pixels)[is_reliable],
        (deviation * pixels)[is_reliable],
        estimate[is_reliable],
    )
    return beyond, error, k1


@dataclass
class _Fit:
    """k1 and a small rotation of every camera, (cameras, 4), fitted to all matches."""

    cameras: Sequence[Camera]
    pairs: Sequence[PairMatches]

    def __post_init__(self) -> None:
        sizes = [len(pair.first_rays) for pair in self.pairs]
        self._first, self._second = (np.array([getattr(p, s) for p in self.pairs], int) for s in ("first", "second"))
        self._pair = np.repeat(np.arange(len(sizes)), sizes)
        self._ends = np.cumsum(sizes)
        self._first_rays, self._second_rays = (
            np.concatenate([np.empty((0, 2)), *(getattr(pair, side) for pair in self.pairs)])
            for side in ("first_rays", "second_rays")
        )
        self._rotations = np.array([camera.world_to_camera[:3, :3] for camera in self.cameras])
        centres = np.array([camera_centre(camera) for camera in self.cameras])
        self._baselines = centres[self._first] - centres[self._second]
        self._focal_lengths = np.array([camera.fx for camera in self.cameras])[self._first][self._pair]
        self._weights = np.ones(len(self._pair))

    def matches_of_cameras(self) -> NDArray[np.int64]:
        """Matches of each camera that still have weight."""
        kept, count = self._pair[self._weights > 0], len(self.cameras)
        return np.bincount(self._first[kept], minlength=count) + np.bincount(self._second[kept], minlength=count)

    def radii(self) -> F64:
        """The radius of each camera, in its focal lengths, within which nearly all of its matches lie."""
        by_camera: list[list[F64]] = [[np.zeros(1)] for _ in self.cameras]
        for pair in self.pairs:
            by_camera[pair.first].append(np.linalg.norm(pair.first_rays, axis=1))
            by_camera[pair.second].append(np.linalg.norm(pair.second_rays, axis=1))
        return np.array([np.quantile(np.concatenate(each), _RADIUS_QUANTILE) for each in by_camera])

    def solve(self) -> tuple[F64, F64]:
        """k1 of every camera and its standard deviation."""
        unknowns = np.zeros((len(self.cameras), _UNKNOWNS_PER_CAMERA))
        scales = np.tile([_K1_PRIOR, *[_ROTATION_PRIOR] * 3], len(self.cameras))
        for turn in range(_GAUSS_NEWTON_STEPS):
            missed = self._distances(unknowns[self._first], unknowns[self._second])
            reach = _FIRST_REACH_PIXELS * _REACH_DECAY**turn
            sizes = np.abs(missed)
            near = sizes[sizes < max(reach, 4.0)]
            deviation = max(_MIN_DEVIATION_PIXELS, 1.5 * float(np.median(near)) if len(near) else 0.0)
            self._weights = tukey(missed, max(reach, 4 * deviation))
            normal, gradient = self._normal_equations(unknowns, missed)
            prior = (deviation / scales) ** 2
            normal[np.diag_indices_from(normal)] += prior
            unknowns -= np.linalg.solve(normal, gradient + prior * unknowns.ravel()).reshape(unknowns.shape)
        spread = np.sqrt(np.diag(np.linalg.inv(normal))) * deviation
        return unknowns[:, 0], spread.reshape(unknowns.shape)[:, 0]

    def _normal_equations(self, unknowns: F64, missed: F64) -> tuple[F64, F64]:
        size = unknowns.size
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        slopes = self._slopes(unknowns, missed)
        weighted = slopes * self._weights[:, None]
        for pair, end in enumerate(self._ends):
            rows = slice(end - len(self.pairs[pair].first_rays), end)
            sides = self._first[pair], self._second[pair]
            columns = [_UNKNOWNS_PER_CAMERA * camera + k for camera in sides for k in range(_UNKNOWNS_PER_CAMERA)]
            normal[np.ix_(columns, columns)] += weighted[rows].T @ slopes[rows]
            gradient[columns] += missed[rows] @ weighted[rows]
        return normal, gradient

    def _slopes(self, unknowns: F64, missed: F64) -> F64:
        """How fast the distances (M,) grow with the unknowns (M, 8) of each match's first and second camera."""
        slopes = np.empty((len(missed), 2 * _UNKNOWNS_PER_CAMERA))
        for column in range(2 * _UNKNOWNS_PER_CAMERA):
            sides = unknowns[self._first], unknowns[self._second]
            sides[column // _UNKNOWNS_PER_CAMERA][:, column % _UNKNOWNS_PER_CAMERA] += _DERIVATIVE_STEP
            slopes[:, column] = (self._distances(*sides) - missed) / _DERIVATIVE_STEP
        return slopes

    def _distances(self, first: F64, second: F64) -> F64:
        """Distances (M,) of all matches, in pixels, by the unknowns (pairs, 4) of the pairs' cameras."""
        one, two = (
            np.array([cv2.Rodrigues(turn)[0] for turn in unknowns[:, 1:]]) @ self._rotations[cameras]
            for unknowns, cameras in ((first, self._first), (second, self._second))
        )
        essential = essential_matrices(one, two, self._baselines)[self._pair]
        first_rays = _undistort(self._first_rays, first[self._pair, 0])
        second_rays = _undistort(self._second_rays, second[self._pair, 0])
        return np.asarray(sampson_distances(first_rays, second_rays, essential) * self._focal_lengths)


def _undistort(rays: F64, k1: F64) -> F64:
    """Rays (N, 2) undistorted by k1 (N,), by fixed-point iteration, which converges for k1 r^2 well below 1."""
    straight = rays
    for _ in range(5):
        straight = rays / np.maximum(1 + k1 * (straight[:, 0] ** 2 + straight[:, 1] ** 2), 0.2)[:, None]
    return straight
