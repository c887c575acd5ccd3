"""View-dependent colour: gloss, mirrors, sheen.

The evidence compares colours of points that neighbouring cameras share, without the cameras' overall difference. **Only
the absence of view dependence can be determined this way**: views that agree to a few levels have none. A disagreement
may be gloss, or different resampling of a slanted surface, which is large at textures strong enough for matching: a
matte wall (in the tests) disagrees by 11 levels, a matte rendering of `workbench` by 9.2, the same with its gloss by
9.4, `workbench` itself by 10.2. So the confidence in view dependence is at most one half.

**The keyframe decides then.** It is trained with the preset's harmonics, and rounding (`training/keyframe.py`) keeps
the visible ones: on three synthetic rigs 2 to 3 of a thousand Gaussians keep any, on a recorded dome 119.
Below ``MIN_SHOWN`` the stream has none, and later frames train none. Rejected: a second training without harmonics,
to compare the tiles left out of the loss (twice the time, and two trainings differ by more than that by chance).
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from decogs.codec.state import Attributes
from decogs.formats.splats import sh_degree_of

from ..numerics import bilinear
from ..settings.encode import EncodeSettings
from .effect import F64, Decision, Effect, Evidence, cameras_beyond, confidence, decided
from .matches import U8, PairMatches
from .rig_statistics import RigStatistics

_LIMIT = 4.0
"""Levels of 255: the same as the smallest change between frames that counts."""
_QUANTILE = 0.9
"""Quantile of the matches' differences: gloss is a small part of a scene."""
_NEAR_LINE = 1.5
"""Largest distance of an inlier from its epipolar line, in pixels."""
_MIN_MATCHES = 30
_SMOOTHING = 2.0
"""Deviation, in pixels, of the smoothing before the comparison: finer detail depends on resampling."""
_DARK = 8.0
"""Levels added before logarithms, which limits the weight of noise in dark pixels."""
_MAX_CONFIDENCE = 0.5
MIN_SHOWN = 0.01
"""Least share of a keyframe's Gaussians with harmonics of a degree or above for the stream to have that degree."""


class ViewDependence(Effect):
    """Colour that depends on where it is seen from."""

    name = "view_dependence"

    def evidence(self, stats: RigStatistics) -> Evidence:
        smooth = [cv2.GaussianBlur(pictures[0], (0, 0), _SMOOTHING).astype(np.float32) for pictures in stats.pictures]
        found: list[list[F64]] = [[] for _ in stats.cameras]
        for pair in stats.matches.pairs:
            differences = _differences(stats, pair, smooth[pair.first], smooth[pair.second])
            found[pair.first].append(differences)
            found[pair.second].append(differences)
        values = np.full((len(stats.cameras), len(stats.frames)), np.nan)
        for row, each in enumerate(found):
            levels = np.concatenate(each) if each else np.empty(0)
            if len(levels) >= _MIN_MATCHES:
                values[row, 0] = np.quantile(levels, _QUANTILE)
        return Evidence(values, "levels", _LIMIT)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        known = np.isfinite(evidence.peak)
        beyond = cameras_beyond(evidence)
        return decided(
            stats,
            self,
            evidence,
            counts=beyond if known else np.ones(len(stats.cameras), bool),
            reason=f"a tenth of the shared points differ by {evidence.peak:.1f} levels or more: gloss, or slant"
            if known
            else "undetermined, so assumed: too few points are seen by two cameras",
            cost="9 more parameters per Gaussian to train (SH degree 1); coded only if the keyframe keeps some",
            sure=min(_MAX_CONFIDENCE, confidence(evidence)) if beyond.any() or not known else confidence(evidence),
        )

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """One colour for all directions."""
        rates = replace(settings.frame.rates, sh_rest=0.0)
        keyframe = replace(settings.keyframe, sh_degree=0)
        return replace(settings, keyframe=keyframe, frame=replace(settings.frame, rates=rates))


def as_far_as_shown(values: Attributes) -> Attributes:
    """A keyframe's rounded ``values`` without the SH degrees that hardly any Gaussian uses."""
    degree = sh_degree_of(values.coefficients)
    while degree and values.sh[:, degree**2 :].any(axis=(1, 2)).sum() < MIN_SHOWN * len(values):
        degree -= 1
    return replace(values, sh=np.ascontiguousarray(values.sh[:, : (degree + 1) ** 2]))


def _differences(stats: RigStatistics, pair: PairMatches, first: U8 | F64, second: U8 | F64) -> F64:
    """Differences in colour, in levels, of a pair's inlier matches, beyond their common difference."""
    near = np.abs(pair.epipolar_distances(stats.cameras)) < _NEAR_LINE
    if not near.any():
        return np.empty(0)
    here = bilinear(first, *pair.first_pixels[near].T).astype(np.float64)
    there = bilinear(second, *pair.second_pixels[near].T).astype(np.float64)
    ratio = np.log((there + _DARK) / (here + _DARK))
    ratio -= np.median(ratio, axis=0)
    return np.asarray(np.abs(ratio * (here + _DARK)).max(axis=1))
