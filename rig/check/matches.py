"""Matches between the first pictures of neighbouring cameras: SIFT with a mutual check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import undistort_pixels
from decogs.formats.cameras import Camera, camera_centre

from ..matching import mutual_matches

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_MAX_FEATURES = 800
_DESCRIPTOR_MARGIN_PIXELS = 16
"""Pixels around a masked feature that describe it."""
_NEIGHBOUR_CAMERAS = 4
_MAX_AXES_ANGLE = 1.0
"""Angle between optical axes, in radians, beyond which SIFT hardly matches."""
NEAR_LINE_PIXELS = 3.0
"""Largest distance of a reliable match from its epipolar line, in pixels, with room for uncalibrated distortion."""


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

    def through(self, camera: Camera) -> Features:
        """The same if ``camera`` took the picture; those that its lens cannot have shown lie at its edge."""
        return replace(self, rays=np.nan_to_num(rays_of(camera, self.pixels), nan=1.0))


def find_matches(cameras: Sequence[Camera], pictures: Sequence[U8], each: Callable[..., Iterator[Any]]) -> Matches:
    """Matches between every camera and the few whose optical axes are nearest to its own."""
    return match_features(cameras, list(each(features_of, cameras, pictures)), each)


def match_features(
    cameras: Sequence[Camera], features: Sequence[Features], each: Callable[..., Iterator[Any]]
) -> Matches:
    """The same from the pictures' ``features``."""
    pairs = neighbouring(cameras)
    return Matches(tuple(each(lambda pair: matched(pair[0], pair[1], features[pair[0]], features[pair[1]]), pairs)))


def join_matches(moments: Sequence[Matches]) -> Matches:
    """The matches of the same pairs of cameras at several moments as one."""
    names = ("first_pixels", "second_pixels", "first_rays", "second_rays")
    joined = []
    for pairs in zip(*(each.pairs for each in moments), strict=True):
        parts = [np.concatenate([getattr(pair, name) for pair in pairs]) for name in names]
        joined.append(PairMatches(pairs[0].first, pairs[0].second, *parts))
    return Matches(tuple(joined))


def epipolar_distances(one: Camera, two: Camera, first_rays: F64, second_rays: F64) -> F64:
    """Signed distances (N,), in the first camera's pixels, of matched rays x/z, y/z (N, 2) from epipolar lines."""
    rotations = [camera.world_to_camera[:3, :3] for camera in (one, two)]
    essential = essential_matrices(rotations[0], rotations[1], camera_centre(one) - camera_centre(two))
    return sampson_distances(first_rays, second_rays, essential) * one.fx


def essential_matrices(first: F64, second: F64, baselines: F64) -> F64:
    """Essential matrices (..., 3, 3) of pairs of cameras, from rays of the first to lines among those of the second.

    ``first``, ``second`` (..., 3, 3): world to camera; ``baselines`` (..., 3): centre of the first minus that of the
    second, world units.
    """
    towards = baselines / np.maximum(np.linalg.norm(baselines, axis=-1, keepdims=True), 1e-12)
    x, y, z = np.moveaxis((second @ towards[..., None])[..., 0], -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*x.shape, 3, 3)
    return np.asarray(cross @ second @ np.swapaxes(first, -1, -2))


def sampson_distances(first: F64, second: F64, essential: F64) -> F64:
    """Signed Sampson distances (N,) of matches (N, 2) of rays x/z, y/z, in focal lengths.

    ``essential`` (3, 3), or (N, 3, 3) for matches of several pairs of cameras.
    Source: Hartley and Zisserman, Multiple View Geometry, 11.4.3 (Sampson distance).
    """
    rows = np.moveaxis(essential.reshape(-1, 3, 3), 0, -1)
    (x, y), (u, v) = first.T, second.T
    line, back = rows[:, 0] * x + rows[:, 1] * y + rows[:, 2], rows[0] * u + rows[1] * v + rows[2]
    slope = line[0] ** 2 + line[1] ** 2 + back[0] ** 2 + back[1] ** 2
    return np.asarray((line[0] * u + line[1] * v + line[2]) / np.sqrt(slope / 2 + 1e-12))


def features_of(camera: Camera, picture: U8, mask: U8 | None = None) -> Features:
    """SIFT features of a picture (H, W, 3), where ``mask`` (H, W) is not 0."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    window = (slice(None), slice(None)) if mask is None else _window(mask)
    keypoints: Sequence[cv2.KeyPoint] = ()
    descriptors = None
    if grey[window].size:
        within = None if mask is None else np.ascontiguousarray(mask[window])
        keypoints, descriptors = cv2.SIFT_create(_MAX_FEATURES).detectAndCompute(grey[window], within)  # type: ignore[attr-defined]
    if descriptors is None:
        return Features(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 128), np.float32))
    corner = [window[1].start or 0, window[0].start or 0]
    pixels = np.array([keypoint.pt for keypoint in keypoints]) + corner + 0.5
    rays = rays_of(camera, pixels)
    # Square roots of shares compare better than the descriptors themselves (Arandjelovic and Zisserman, RootSIFT).
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-9))
    finite = np.isfinite(rays).all(axis=1)
    return Features(pixels[finite], rays[finite], roots[finite].astype(np.float32))


def rays_of(camera: Camera, pixels: F64) -> F64:
    """Rays x/z and y/z (N, 2) that a camera's ``pixels`` (N, 2) show; NaN beyond its lens."""
    return np.asarray((undistort_pixels(camera, pixels) - [camera.cx, camera.cy]) / [camera.fx, camera.fy])


def _window(mask: U8) -> tuple[slice, slice]:
    """Rows and columns where a mask (H, W) is not 0, and those that describe features there; none of an empty mask."""
    x, y, width, height = cv2.boundingRect(mask)
    rows, columns = (
        slice(max(0, begin - _DESCRIPTOR_MARGIN_PIXELS), begin + size + _DESCRIPTOR_MARGIN_PIXELS)
        if size
        else slice(0, 0)
        for begin, size in ((y, height), (x, width))
    )
    return rows, columns


def neighbouring(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pairs of cameras, each with the few whose optical axes are nearest to its own."""
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    angles = np.arccos(np.clip(axes @ axes.T, -1, 1))
    pairs = set()
    for row in range(len(cameras)):
        near = [k for k in np.argsort(angles[row], kind="stable").tolist() if k != row][:_NEIGHBOUR_CAMERAS]
        pairs |= {(min(row, k), max(row, k)) for k in near if angles[row, k] < _MAX_AXES_ANGLE}
    return sorted(pairs)


def matched(first: int, second: int, first_features: Features, second_features: Features) -> PairMatches:
    """Matches of two pictures, of the cameras ``first`` and ``second``: mutual ones, clearly better than the next."""
    rows, columns = mutual_matches(first_features.descriptors, second_features.descriptors)
    return PairMatches(
        first,
        second,
        first_features.pixels[rows],
        second_features.pixels[columns],
        first_features.rays[rows],
        second_features.rays[columns],
    )
