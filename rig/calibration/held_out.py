"""How well cameras fit matches that they were not fitted to: what decides between mappers, lens models and more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from decogs.decoder.cameras.lens import undistort_pixels
from decogs.formats.cameras import Camera, camera_centre, ray_slopes

from ..check.matches import essential_matrices, sampson_distances
from .features import F64, I64, Features

_CAP_PIXELS = 3.0
"""Distance from the epipolar line from which a match counts as wrong: ten times SIFT's accuracy."""
_HELD_OUT = 8
"""Every so manieth track is held out."""
_CLEARLY = 5.0
"""Standard errors of the mean gain. With 4, straight lenses of `n3dv_flame_steak_frame0` come out bent, and focal
lengths 4 % off; lenses that bend (k1 = -.15) gain more where four cameras see them."""


@dataclass(frozen=True)
class PairMatches:
    """Matches of two cameras: rows (M, 2) of their features that are fitted to, and those (K, 2) held out."""

    first: int
    second: int
    fitted: I64
    held_out: I64


@dataclass(frozen=True)
class Score:
    """``cost``: root of the mean squared distance of held-out matches from their epipolar lines, px, capped at 3.

    ``error``: the median distance of those within that, px; ``explained``: their share. ``distances``: all of them.
    """

    cost: float
    error: float
    explained: float
    distances: F64

    def is_clearly_better(self, than: Score) -> bool:
        """Whether the same matches fit better by more than chance: a paired test of their Cauchy losses."""
        scale = max(min(self.error, than.error), 1e-9)
        gains = np.log1p((than.distances / scale) ** 2) - np.log1p((self.distances / scale) ** 2)
        return bool(gains.mean() > _CLEARLY * gains.std() / np.sqrt(max(len(gains), 1)))


def split(features: Sequence[Features], matches: Mapping[tuple[int, int], I64]) -> tuple[PairMatches, ...]:
    """Holds out an eighth of the tracks: what matches hang together by, over all cameras."""
    firsts = np.cumsum([0, *(len(camera.pixels) for camera in features)])
    links = [pair + np.array([firsts[a], firsts[b]]) for (a, b), pair in matches.items()]
    tracks = _components(int(firsts[-1]), np.concatenate([*links, np.zeros((0, 2), np.int64)]))
    pairs = []
    for (a, b), pair in matches.items():
        held = tracks[pair[:, 0] + firsts[a]] % _HELD_OUT == 0
        pairs.append(PairMatches(a, b, pair[~held], pair[held]))
    return tuple(pairs)


def _components(count: int, links: I64) -> I64:
    """The smallest member (count,) of what each hangs together with, by links (L, 2)."""
    label = np.arange(count)
    while True:
        least = np.minimum(label[links[:, 0]], label[links[:, 1]])
        following = label.copy()
        np.minimum.at(following, links[:, 0], least)
        np.minimum.at(following, links[:, 1], least)
        following = following[following]
        if np.array_equal(following, label):
            return label
        label = following


def score(cameras: Mapping[int, Camera], features: Sequence[Features], pairs: Sequence[PairMatches]) -> Score:
    """The score of cameras, by their number; matches of one that is not among them count as wrong."""
    rays = {number: rays_of(camera, features[number].pixels) for number, camera in cameras.items()}
    distances = [np.zeros(0)]
    for pair in pairs:
        if pair.first in cameras and pair.second in cameras:
            first_rays, second_rays = rays[pair.first][pair.held_out[:, 0]], rays[pair.second][pair.held_out[:, 1]]
            distances.append(epipolar_pixels(cameras[pair.first], cameras[pair.second], first_rays, second_rays))
        else:
            distances.append(np.full(len(pair.held_out), _CAP_PIXELS))
    every = np.minimum(np.concatenate(distances), _CAP_PIXELS)
    within = every[every < _CAP_PIXELS]
    if not within.size:
        return Score(_CAP_PIXELS, _CAP_PIXELS, 0.0, every)
    return Score(float(np.sqrt((every**2).mean())), float(np.median(within)), len(within) / len(every), every)


def rays_of(camera: Camera, pixels: F64) -> F64:
    """Rays x/z, y/z (N, 2) of pixels (N, 2), through the camera's lens."""
    return np.stack(ray_slopes(camera, *undistort_pixels(camera, pixels).T), axis=1)


def epipolar_pixels(one: Camera, two: Camera, first_rays: F64, second_rays: F64) -> F64:
    """Distances (N,) in pixels of matched rays from their epipolar lines; infinite where a lens has no ray."""
    rotations = one.world_to_camera[:3, :3], two.world_to_camera[:3, :3]
    essential = essential_matrices(*rotations, camera_centre(one) - camera_centre(two))
    distances = np.abs(sampson_distances(first_rays, second_rays, essential)) * (one.fx + two.fx) / 2
    return np.where(np.isfinite(distances), distances, np.inf)
