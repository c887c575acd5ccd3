"""Matches between the first pictures of neighbouring cameras: SIFT with a mutual check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.lens import undistort_pixels
from decogs.formats.cameras import Camera, camera_centre

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_FEATURES = 800
_NEIGHBOURS = 4
_WIDEST_ANGLE = 1.0
"""Angle between optical axes, in radians, beyond which SIFT hardly matches."""
NEAR_LINE = 3.0
"""Largest distance of a believed match from its epipolar line, in pixels, with room for uncalibrated distortion."""
_RATIO = 0.8
"""Lowe's ratio: largest distance of the best match over the second best."""


@dataclass(frozen=True)
class PairMatches:
    """Matches of two cameras, ``first`` and ``second`` in the statistics' order: pixels (N, 2) in both pictures.

    ``first_rays``, ``second_rays`` (N, 2): the same as x/z and y/z, by the calibrated lens. Corner of the picture at 0.
    """

    first: int
    second: int
    first_pixels: F64
    second_pixels: F64
    first_rays: F64
    second_rays: F64

    def epipolar_distances(self, cameras: Sequence[Camera]) -> F64:
        """Distances (N,) of the matches from their epipolar lines, in pixels of the first camera, signed."""
        return epipolar_distances(cameras[self.first], cameras[self.second], self.first_rays, self.second_rays)


@dataclass(frozen=True)
class Matches:
    """Matches of pairs of neighbouring cameras, including wrong ones."""

    pairs: tuple[PairMatches, ...]


@dataclass(frozen=True)
class Features:
    """A picture's features: pixels (N, 2), rays x/z and y/z (N, 2), descriptors (N, 128)."""

    pixels: F64
    rays: F64
    descriptors: NDArray[np.float32]


def find_matches(cameras: Sequence[Camera], pictures: Sequence[U8], each: Callable[..., Iterator[Any]]) -> Matches:
    """Matches between every camera and the few whose optical axes are nearest to its own."""
    features: list[Features] = list(each(features_of, cameras, pictures))
    pairs = neighbouring(cameras)
    return Matches(tuple(each(lambda pair: matched(pair[0], pair[1], features[pair[0]], features[pair[1]]), pairs)))


def epipolar_distances(one: Camera, two: Camera, here: F64, there: F64) -> F64:
    """Signed distances (N,), in the first camera's pixels, of matched rays x/z, y/z (N, 2) from epipolar lines."""
    rotations = [camera.world_to_camera[:3, :3] for camera in (one, two)]
    return sampson_distances(here, there, rotations, camera_centre(one) - camera_centre(two)) * one.fx


def sampson_distances(first: F64, second: F64, rotations: Sequence[F64], baseline: F64) -> F64:
    """Signed Sampson distances (N,) of matches (N, 2) of rays x/z, y/z, in focal lengths.

    ``rotations``: world to camera, of both; ``baseline``: centre of the first minus that of the second, world units.
    Source: Hartley and Zisserman, Multiple View Geometry, 11.4.3 (Sampson distance).
    """
    relative = rotations[1] @ rotations[0].T
    x, y, z = rotations[1] @ baseline / max(float(np.linalg.norm(baseline)), 1e-12)
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ relative
    here, there = (np.concatenate([rays, np.ones((len(rays), 1))], axis=1) for rays in (first, second))
    lines, back = here @ essential.T, there @ essential
    slope = (lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)
    return np.asarray((there * lines).sum(axis=1) / np.sqrt(slope / 2 + 1e-12))


def features_of(camera: Camera, picture: U8, mask: U8 | None = None) -> Features:
    """SIFT features of a picture (H, W, 3), where ``mask`` (H, W) is not 0."""
    keypoints, descriptors = cv2.SIFT_create(_FEATURES).detectAndCompute(  # type: ignore[attr-defined]
        cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), mask
    )
    if descriptors is None:
        return Features(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 128), np.float32))
    pixels = np.array([keypoint.pt for keypoint in keypoints]) + 0.5
    straight = undistort_pixels(camera, pixels)
    rays = (straight - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    # Square roots of shares compare better than the descriptors themselves (Arandjelovic and Zisserman, RootSIFT).
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    known = np.isfinite(rays).all(axis=1)
    return Features(pixels[known], rays[known], roots[known].astype(np.float32))


def neighbouring(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pairs of cameras, each with the few whose optical axes are nearest to its own."""
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    angles = np.arccos(np.clip(axes @ axes.T, -1, 1))
    pairs = set()
    for row in range(len(cameras)):
        near = [k for k in np.argsort(angles[row], kind="stable").tolist() if k != row][:_NEIGHBOURS]
        pairs |= {(min(row, k), max(row, k)) for k in near if angles[row, k] < _WIDEST_ANGLE}
    return sorted(pairs)


def matched(first: int, second: int, here: Features, there: Features) -> PairMatches:
    """Matches of two pictures, of the cameras ``first`` and ``second``: mutual ones, clearly better than the next."""
    rows, columns = _mutual(here.descriptors, there.descriptors)
    return PairMatches(first, second, here.pixels[rows], there.pixels[columns], here.rays[rows], there.rays[columns])


def _mutual(here: NDArray[np.float32], there: NDArray[np.float32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows that are each other's best match, and clearly better than the second best."""
    if len(here) < 2 or len(there) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = np.array([match.trainIdx for match in matcher.match(there, here)])
    forth = matcher.knnMatch(here, there, k=2)
    found = [
        (best.queryIdx, best.trainIdx)
        for best, second in forth
        if best.distance < _RATIO * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    rows = np.array(found, np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]
