"""Exposure and white balance of all cameras at once, from points of the scene's surface that several cameras see.

A scene in training absorbs errors of its training pictures, above all errors that neighbouring cameras share. An error
that is smooth along the rig therefore hardly shrinks when it is measured against the scene's renderings. So only the
depth of an unfinished keyframe is used. Points of its surface are looked up in every picture that sees them, and the
shifts of all cameras under which the colours agree best are solved for directly.

Later frames compare each picture with the scene before the frame. Light may have changed differently at every point,
but it changed alike for all cameras. Each point's change of light is eliminated, and the cameras' own drift remains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import in_picture, project, ray_slopes, turned
from decogs.formats.splats import FloatArray, logit
from decogs.rig.numerics import bilinear
from decogs.rig.pictures.ingest import View

from ...backends import RenderedPicture
from .colour import LogitShift, tukey_weights, unclipped

F64 = NDArray[np.float64]


DrawView = Callable[[int], RenderedPicture]
"""The scene through the training view of that number, with its depth."""

_POINTS_PER_VIEW = 2000
"""Points of the surface taken from each view."""

_OPAQUE_ALPHA = 0.9
_SAME_DEPTH_FRACTION = 0.02
"""A point is seen where the depth of the view there is its own, to this share."""

_SOLVER_ROUNDS = 6

_LATER_POINTS = 6000
"""Points of later frames, from all views together: the light of a single one is known to a per cent."""

_COLOUR_WINDOW = np.mgrid[-1:2, -1:2].reshape(2, 1, -1)
"""Pixels over which a point's colours are averaged."""

_MIN_SHARED_POINTS = 100
"""Points shared with other views below which a view is undetermined."""


@dataclass(frozen=True)
class SharedSurface:
    """Points of the scene's surface (P,) as the views see them: pixels (V, P) ``row`` and ``column`` where ``seen``."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    seen: NDArray[np.bool_]

    def colours(self, number: int, picture: FloatArray) -> FloatArray:
        """The mean colours (P, 3) around the points in a view's picture (3, H, W); black where it sees none."""
        height, width = picture.shape[1:]
        colours = np.zeros((self.seen.shape[1], 3), np.float32)
        seen = self.seen[number]
        rows = np.clip(self.row[number, seen, None] + _COLOUR_WINDOW[0], 0, height - 1)
        columns = np.clip(self.column[number, seen, None] + _COLOUR_WINDOW[1], 0, width - 1)
        colours[seen] = picture[:, rows, columns].mean(axis=2).T
        return colours


class SharedChanges(NamedTuple):
    """How later pictures differ from the renderings, as logit shifts.

    ``shifts`` (V, 3): the views' own, up to a common one. ``common`` (3,): the median of the rest at the points.
    ``has_overlap`` (V,): views that share enough points with others.
    """

    shifts: F64
    common: F64
    has_overlap: NDArray[np.bool_]


def shared_surface(views: Sequence[View], draw: DrawView) -> SharedSurface:
    """Points of the scene's surface, found in every view that sees them."""
    depths = [_depth(draw(number)) for number in range(len(views))]
    samples = _LATER_POINTS // len(views)
    points = np.concatenate([_surface(view, depth, samples) for view, depth in zip(views, depths, strict=True)])
    pixels = [_pixels(view, depth, points) for view, depth in zip(views, depths, strict=True)]
    row, column = (np.stack([of_view[k] for of_view in pixels]).astype(np.int64) for k in range(2))
    seen = np.stack([inside for _, _, inside in pixels])
    several = seen.sum(axis=0) > 1
    return SharedSurface(row[:, several], column[:, several], seen[:, several])


def shared_changes(
    surface: SharedSurface, pictures: Sequence[FloatArray], rendered: Sequence[FloatArray]
) -> SharedChanges:
    """The views' own part of the difference of ``pictures`` from ``rendered``, (3, H, W) of every view each."""
    views = len(pictures)
    shifts, common, enough = np.zeros((views, 3)), np.zeros(3), np.zeros((views, 3), bool)
    now, before = (
        np.stack([surface.colours(number, picture) for number, picture in enumerate(side)])
        for side in (pictures, rendered)
    )
    for channel in range(3):
        usable = surface.seen & unclipped(now[..., channel]) & unclipped(before[..., channel])
        usable &= usable.sum(axis=0) > 1
        enough[:, channel] = usable.sum(axis=1) >= _MIN_SHARED_POINTS
        if not enough[:, channel].any():
            continue
        v, s = (np.where(usable, side[..., channel], np.float32(0.5)) for side in (now, before))
        logs, slope = logit(v) - logit(s), s * (1 - s)
        solved, weights = _solved(logs, slope, usable)
        shifts[:, channel] = solved
        total = weights.sum(axis=0)
        left = (weights * (logs - solved[:, None].astype(np.float32))).sum(axis=0)[total > 0] / total[total > 0]
        common[channel] = np.median(left) if len(left) else 0.0
    return SharedChanges(shifts, common, np.asarray(enough.all(axis=1)))


def agreeing_shifts(views: Sequence[View], pictures: Sequence[FloatArray], draw: DrawView) -> list[LogitShift]:
    """Every view's logit shift, up to one common shift a channel, which is chosen so that their mean is 0.

    ``pictures``: (3, H, W) of every view, turns taken out. A view that shares nothing with others gets 0.
    """
    depths = [_depth(draw(number)) for number in range(len(views))]
    points = np.concatenate(
        [_surface(view, depth, _POINTS_PER_VIEW) for view, depth in zip(views, depths, strict=True)]
    )
    if not len(points):
        return [LogitShift(np.zeros(3), np.zeros(3))] * len(views)
    seen = [
        _colours(view, cv2.blur(picture.transpose(1, 2, 0), (3, 3)), depth, points)
        for view, picture, depth in zip(views, pictures, depths, strict=True)
    ]
    values, inside = np.stack([colours for colours, _ in seen]), np.stack([visible for _, visible in seen])
    solved = [_channel_shifts(values[..., channel], inside & unclipped(values[..., channel])) for channel in range(3)]
    return [LogitShift(*map(np.array, zip(*of_view, strict=True))) for of_view in zip(*solved, strict=True)]


def shifts_of_points(values: FloatArray, seen: NDArray[np.bool_]) -> tuple[F64, NDArray[np.bool_]]:
    """Every view's logit shift (V, 3), up to one common shift a channel, and which views (V,) share enough.

    ``values`` (V, P, 3): colours of points that the views see where ``seen`` (V, P).
    """
    shifts, enough = np.zeros((len(values), 3)), np.ones(len(values), bool)
    for channel in range(3):
        valid = seen & unclipped(values[..., channel])
        valid &= valid.sum(axis=0) > 1
        enough &= valid.sum(axis=1) >= _MIN_SHARED_POINTS
        shifts[:, channel] = [shift for shift, _ in _channel_shifts(values[..., channel], valid)]
    return shifts, enough


def _depth(picture: RenderedPicture) -> FloatArray:
    """Depth (H, W) of what the view sees, NaN where that is not opaque."""
    assert picture.depth is not None
    with np.errstate(divide="ignore", invalid="ignore"):
        depth: FloatArray = picture.depth / picture.alpha
    return np.where(picture.alpha > _OPAQUE_ALPHA, depth, np.float32(np.nan))


def _surface(view: View, depth: FloatArray, samples: int) -> F64:
    """About so many points (P, 3) of the surface, on a regular grid of the view's pixels."""
    camera, step = view.pinhole, max(1, round(np.sqrt(depth.size / samples)))
    rows, columns = (
        grid.ravel() for grid in np.mgrid[step // 2 : camera.height : step, step // 2 : camera.width : step]
    )
    z = depth[rows, columns].astype(np.float64)
    finite = np.isfinite(z)
    z, rows, columns = z[finite], rows[finite], columns[finite]
    x, y = ray_slopes(camera, columns + 0.5, rows + 0.5)
    pose = camera.world_to_camera
    return turned(pose[:3, :3].T, np.stack([x * z, y * z, z], axis=1) - pose[:3, 3])


def _colours(view: View, picture: FloatArray, depth: FloatArray, points: F64) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The picture's colours (P, 3) of the points, and which of them (P,) the view sees."""
    v, u, inside = _pixels(view, depth, points)
    return bilinear(picture, u, v), inside


def _pixels(view: View, depth: FloatArray, points: F64) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Row and column of the points (P,) in the view, corner of the picture at 0, and which of them it sees; 0 of
    others."""
    u, v, z = project(view.pinhole, points)
    inside = in_picture(view.pinhole, u, v, z)
    column, row = (np.where(inside, pixel, 0).astype(np.int64) for pixel in (u, v))
    with np.errstate(invalid="ignore"):
        inside &= np.abs(depth[row, column] / np.where(inside, z, 1) - 1) < _SAME_DEPTH_FRACTION
    if view.valid is not None:
        inside &= view.valid[row, column] > 0
    return np.where(inside, v, 0), np.where(inside, u, 0), inside


def _channel_shifts(values: FloatArray, usable: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Shift and precision of every view, from values (V, P) of points that it sees where ``usable``."""
    usable = usable & (usable.sum(axis=0) > 1)
    if not usable.any():
        return [(0.0, 0.0)] * len(values)
    inside = np.where(usable, values, np.float32(0.5))
    shifts, weights = _solved(logit(inside), inside * (1 - inside), usable)
    return list(zip(shifts.tolist(), weights.sum(axis=1, dtype=np.float64).tolist(), strict=True))


def _solved(logs: FloatArray, slope: FloatArray, usable: NDArray[np.bool_]) -> tuple[F64, FloatArray]:
    """Every view's shift (V,) of the logits (V, P) of points that it sees where ``usable``, and their weights.

    ``slope``: of the colour over its logit. Robust least squares; each point's own logit is eliminated.
    """
    weights = np.square(slope) * usable
    shifts = np.zeros(len(logs))
    for _ in range(_SOLVER_ROUNDS):
        total = np.maximum(weights.sum(axis=0), np.float32(1e-9))
        mean = (weights * logs).sum(axis=0) / total
        normal = np.diag(weights.sum(axis=1, dtype=np.float64)) - _shared(weights, total)
        right = (weights * (logs - mean)).sum(axis=1, dtype=np.float64)
        # Any common shift fits as well; this picks the one with mean 0, and 0 for views that share nothing.
        scale = max(float(np.trace(normal)) / len(logs), 1e-9)
        shifts = np.linalg.solve(normal + scale * (1 / len(logs) + 1e-6 * np.eye(len(logs))), right)
        corrected = logs - shifts[:, None].astype(np.float32)
        errors = slope * (corrected - (weights * corrected).sum(axis=0) / total)
        weights = np.square(slope) * usable
        weights[usable] *= tukey_weights(errors[usable])
    return shifts, weights


def _shared(weights: FloatArray, total: FloatArray) -> F64:
    """What the elimination of the points couples two views by, (V, V)."""
    return np.array([(weights * (row / total)).sum(axis=1, dtype=np.float64) for row in weights])
