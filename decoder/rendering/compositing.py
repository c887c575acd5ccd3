"""What compositing needs beside a picture: which part of it ever changes, and where everything moves to.

Both are rendered as colours, through the rasteriser that made the picture: a pixel then has the mean of what it shows,
with the weights of its colour. Where a Gaussian is not in the other picture's frame, only the camera moves it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.state import ARRAYS, same_scene
from decogs.formats.cameras import Camera, project
from decogs.formats.splats import SH_C0, FloatArray, Splats

from ..cameras.lens import Redistortion, distort_pixels
from ..reading.frame import DecodedFrame

Ids = NDArray[np.int64]

_FAINTEST = 1 / 255
"""Alpha below which a pixel shows too little to have a mean."""


def static_ids(frames: Iterable[DecodedFrame]) -> Ids:
    """Ids, sorted, of the Gaussians that live in every frame and never change: the static group of a USD export."""
    static, before = np.zeros(0, np.int64), None
    for frame in frames:
        if before is None:
            static = np.sort(frame.state.ids)
        elif not same_scene(before.state, frame.state):
            static = np.intersect1d(static, _kept(before, frame), assume_unique=True)
        before = frame
    return static


def dynamic_part(splats: Splats, ids: Ids, static: Ids, plan: Redistortion, threads: int, pairs: int) -> FloatArray:
    """The part (H, W), 0 to 1, in what each pixel shows of Gaussians whose ids are not among the ``static`` ones."""
    changes = ~np.isin(ids, static, assume_unique=True)
    colours = np.repeat(changes.astype(np.float32)[:, None], 3, axis=1)
    return np.clip(_mean_colour(splats, colours, plan, threads, pairs, nothing=0)[..., 0], 0, 1)


def motion_to(
    shown: DecodedFrame, other: DecodedFrame, seen_by: Camera, plan: Redistortion, threads: int, pairs: int
) -> FloatArray:
    """Where what each pixel shows lies in another picture, (H, W, 2) pixels from here, u to the right and v upwards.

    ``plan`` is that of the picture of ``shown``, ``seen_by`` the camera of the picture of ``other``, lens included.
    """
    before, after = _pixels(plan.camera, shown.splats.means), _pixels(seen_by, _means_in(shown, other))
    moved = (after - before) * np.array([1, -1])
    moved[~np.isfinite(moved).all(axis=1)] = 0
    farthest = float(max(plan.camera.width, plan.camera.height))
    moved = np.clip(moved, -farthest, farthest)
    reach = float(np.abs(moved).max(initial=0))
    if not reach:
        return np.zeros((plan.camera.height, plan.camera.width, 2), np.float32)
    colours = np.full((len(moved), 3), 0.5)
    colours[:, :2] += moved / (2 * reach)  # colours must not be negative
    mean = _mean_colour(shown.splats, colours.astype(np.float32), plan, threads, pairs, nothing=0.5)
    return np.asarray((mean[..., :2] - np.float32(0.5)) * np.float32(2 * reach), np.float32)


def _kept(before: DecodedFrame, after: DecodedFrame) -> Ids:
    """Ids of the Gaussians that both frames have with equal values."""
    common, rows, now = np.intersect1d(before.state.ids, after.state.ids, assume_unique=True, return_indices=True)
    equal = np.ones(len(common), bool)
    for name in ARRAYS:
        same = getattr(before.state, name)[rows] == getattr(after.state, name)[now]
        equal &= same.all(axis=tuple(range(1, same.ndim)))
    return np.asarray(common[equal], np.int64)


def _means_in(shown: DecodedFrame, other: DecodedFrame) -> FloatArray:
    """Positions (N, 3) in the other frame of the Gaussians of this one; where they are now if it has them not."""
    means: FloatArray = shown.splats.means.copy()
    if same_scene(shown.state, other.state):
        return means
    _, rows, other_rows = np.intersect1d(shown.state.ids, other.state.ids, assume_unique=True, return_indices=True)
    means[rows] = other.splats.means[other_rows]
    return means


def _pixels(camera: Camera, points: FloatArray) -> NDArray[np.float64]:
    """Where points lie in the camera's picture, (N, 2); not finite behind it and past its lens."""
    u, v, depth = project(camera, points)
    pixels = np.stack([u, v], axis=-1)
    before = (depth > 0) & np.isfinite(pixels).all(axis=1)
    pixels[~before] = np.nan
    pixels[before] = distort_pixels(camera, pixels[before])
    return pixels


def _mean_colour(
    splats: Splats, colours: FloatArray, plan: Redistortion, threads: int, pairs: int, *, nothing: float
) -> FloatArray:
    """The scene in other colours (N, 3), 0 to 1: the mean (H, W, 3) of what a pixel shows, ``nothing`` if too little.

    Lenses take the nearest rendered pixel: nothing is mixed across edges.
    """
    from ..rasterise import render

    sh = np.ascontiguousarray(((colours - 0.5) / np.float32(SH_C0))[:, None])
    seen = render(replace(splats, sh=sh), plan.render_camera, threads=threads, max_pairs=pairs)
    mean = np.full_like(seen.image, nothing)
    np.divide(seen.image, seen.alpha[..., None], out=mean, where=seen.alpha[..., None] > _FAINTEST)
    return plan.apply(mean, outside=nothing, nearest=True)
