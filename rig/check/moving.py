"""Cameras that move through the scene, which no turn about their centres explains.

A camera that shakes turns: its picture moves by a homography, which an encode estimates and undoes. One that is carried
sees near things move against far ones. Then corners of the first picture that are found again fit no turn. Nor do they
where all of them are on performers before a plain wall; but there most of the picture is what it was.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import undistort_pixels
from decogs.formats.cameras import Camera

from ..numerics import tukey
from .registration import CameraPath, find_again, under_rows_light_of

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_LOOKED_AT = (0.5, 0.75, 1.0)
"""Moments, as shares of the clip: what passes before a camera does not fill all three."""
_FITS_PIXELS = 1.0
"""Distance of a corner from where a turn puts it, within which it fits."""
_MIN_FITTING_SHARE = 0.3
"""Least share of the corners that fit a turn, in a camera that stands: .42 where people fill half of `desk`."""
_MIN_CORNERS = 20
_SAME_LEVELS, _MAX_SAME_SHARE = 8.0, 0.5
"""8-bit levels within which blurred pixels are what they were in the first picture, and the largest share of such in a
camera that moves. In ten seconds of a made stage, whose cameras stand, it is .60 to .79; if one is carried, 0."""
_ROUNDS, _FIRST_REACH = 20, 0.3
"""Of the fit; its weights reach so far at first, in focal lengths, and five pixels at last."""


def moves_through(camera: Camera, pictures: U8, path: CameraPath) -> bool:
    """Whether a camera whose ``path`` is no rest moves so that no turn explains its ``pictures`` (F, H, W, 3)."""
    if not path.shakes:
        return False
    last = len(pictures) - 1
    first = pictures[0]
    moments = sorted({round(share * last) for share in _LOOKED_AT} - {0})
    later = (under_rows_light_of(first, pictures[moment]) for moment in moments)
    return all(
        _turn_fits(camera, first, now) < _MIN_FITTING_SHARE and _same_share(first, now) < _MAX_SAME_SHARE
        for now in later
    )


def _same_share(first: U8, now: U8) -> float:
    """The share of pixels that show what they showed."""
    changed = cv2.absdiff(*(cv2.blur(each.astype(np.float32), (3, 3)) for each in (first, now))).max(axis=2)
    return float((changed < _SAME_LEVELS).mean())


def _turn_fits(camera: Camera, first: U8, now: U8) -> float:
    """The share of corners that fit the turn that most fit; 1 where too few are found to tell."""
    before, after = find_again(first, now)
    if len(before) < _MIN_CORNERS:
        return 1.0
    were, are = (_directions(camera, pixels) for pixels in (before, after))
    turn, reach = np.eye(3), _FIRST_REACH
    for _ in range(_ROUNDS):
        x, y, z = (were @ turn.T).T
        x, y = x / z, y / z
        missed = are[:, :2] - np.stack([x, y], axis=1)
        rows = np.stack([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x]]).transpose(2, 0, 1)
        weight = tukey(np.linalg.norm(missed, axis=1), reach)[:, None, None]
        normal = np.einsum("nij,nik->jk", rows * weight, rows) + 1e-9 * np.eye(3)
        step = np.linalg.solve(normal, np.einsum("nij,ni->j", rows * weight, missed))
        turn = cv2.Rodrigues(step)[0] @ turn
        reach = max(0.7 * reach, 5 / camera.fx)
    return float((np.linalg.norm(missed, axis=1) * camera.fx < _FITS_PIXELS).mean())


def _directions(camera: Camera, pixels: F64) -> F64:
    """Directions (N, 3), at unit depth, that a camera's pixels show; straight ahead beyond its lens."""
    rays = (undistort_pixels(camera, pixels) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    return np.concatenate([np.nan_to_num(rays), np.ones((len(rays), 1))], axis=1)
