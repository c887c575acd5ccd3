"""Confirmation of a sweep's depths: geometric and photometric consistency between views, and free space.

Source: geometric consistency and fusion as in multi-view stereo (Schönberger 2016, "Pixelwise view selection for
unstructured multi-view stereo", section 4.4, and its fusion by reprojection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.rig.numerics import floats

from .plane_sweep import DepthMap
from .views import Array, SweepView, between, inside, pixel_rays, project, was_recorded

_MAX_SHIFT_PIXELS = 1.0
"""Largest difference of equal depths, as a displacement in the other picture, in pixels."""
_MIN_TEXTURE_CORRELATION = 0.5
"""Least correlation of two windows of the same texture."""
_WINDOW_PIXELS = 7
_NOISE_VARIANCE = 0.01**2
_CONTRAST_EXPONENT, _SPACING_RANGE = 0.6, 2.0
_MAX_PATCH_STEP, _MAX_SPECK_SHARE = 0.03, 1e-3
"""Relative change of depth from pixel to pixel within a patch, and share of a picture up to which it is a speck."""
_OCCLUSION_STEP = 0.08
"""Relative change of inverse depth within 3 x 3 pixels at an occlusion edge."""


@dataclass(frozen=True)
class Candidates:
    """Candidate points of one view.

    ``xyz`` (P, 3) float64 world, ``rgb`` (P, 3), ``spacing`` (P,) world size of one pixel there, larger without texture
    and smaller with much; ``confidence`` (P,) 0..1; ``inverse_depth``, ``column``, ``row`` (P,).
    """

    xyz: NDArray[np.float64]
    rgb: Array
    spacing: Array
    confidence: Array
    inverse_depth: Array
    column: NDArray[np.int64]
    row: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.xyz)


def no_candidates() -> Candidates:
    """No points."""
    none, nowhere = np.zeros(0, np.float32), np.zeros(0, np.int64)
    return Candidates(np.zeros((0, 3)), np.zeros((0, 3), np.float32), none, none, none, nowhere, nowhere)


@dataclass(frozen=True)
class _Projection:
    """A view's surface in another view: columns, rows and depths there, (H, W); where it lies behind, -1e4, -1e4 and 0.

    ``base`` (H, W) and ``shift``: depth there is base / inverse depth here + shift.
    """

    u: Array
    v: Array
    depth: Array
    base: Array
    shift: float


def _project_surface(view: SweepView, other: SweepView, inverse_depth: Array) -> _Projection:
    """Projection of a view's surface into another view, from pixel to pixel."""
    matrix, offset = between(view, other)
    columns = np.arange(view.width, dtype=np.float32)
    rows = np.arange(view.height, dtype=np.float32)[:, None]
    ramps = [np.float32(a) * columns + (np.float32(b) * rows + np.float32(c)) for a, b, c in matrix]
    scaled = ramps[2] + np.float32(offset[2]) * inverse_depth
    front = scaled > 1e-6
    reciprocal = np.divide(1.0, scaled, out=np.zeros_like(scaled), where=front)
    u = (ramps[0] + np.float32(offset[0]) * inverse_depth) * reciprocal
    v = (ramps[1] + np.float32(offset[1]) * inverse_depth) * reciprocal
    u[~front], v[~front] = -1e4, -1e4
    depth = np.where(front, scaled / np.maximum(inverse_depth, 1e-12), 0).astype(np.float32)
    return _Projection(u, v, depth, ramps[2], float(offset[2]))


def _sample(picture: Array, u: Array, v: Array, outside: float) -> Array:
    """Bilinear samples of (H, W) at pixel positions (first centre at 0) (H', W')."""
    return np.asarray(
        cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=outside), np.float32
    )


def _within(other: SweepView, u: Array, v: Array) -> NDArray[np.bool_]:
    """Pixel positions (first centre at 0) between pixels that were recorded."""
    fall = np.asarray((u >= 0) & (u <= other.width - 1) & (v >= 0) & (v <= other.height - 1))
    return fall if other.recorded is None else fall & was_recorded(other.recorded, u, v, fall)


def _similarities(view: SweepView, others: Sequence[SweepView], projections: Sequence[_Projection]) -> Array:
    """Correlation of windows of a view and of others around the same surface, (others, H, W); -1 where not seen.

    Windows without texture above noise in either view count as equal.
    """
    window = (_WINDOW_PIXELS, _WINDOW_PIXELS)
    mean = cv2.blur(view.centred, window)
    variance = cv2.blur(view.centred * view.centred, window) - mean * mean + _NOISE_VARIANCE
    scores = np.empty((len(others), view.height, view.width), np.float32)
    for k, (other, projection) in enumerate(zip(others, projections, strict=True)):
        warped = _sample(other.centred, projection.u, projection.v, 0.0)
        other_mean = cv2.blur(warped, window)
        other_variance = cv2.blur(warped * warped, window) - other_mean * other_mean + _NOISE_VARIANCE
        covariance = cv2.blur(view.centred * warped, window) - mean * other_mean + _NOISE_VARIANCE
        scores[k] = covariance / np.sqrt(np.maximum(variance * other_variance, _NOISE_VARIANCE**2))
        scores[k][~_within(other, projection.u, projection.v)] = -1
    return scores


def _better_half(scores: Array) -> Array:
    """Mean (H, W) over the better half of those of the similarities (K, H, W) that come from a view."""
    half = np.maximum(((scores > -1).sum(axis=0) + 1) // 2, 1)
    best = np.arange(len(scores))[:, None, None] < half
    return floats((np.sort(scores, axis=0)[::-1] * best).sum(axis=0) / half)


def _specks(keep: NDArray[np.bool_], inverse_depth: Array) -> NDArray[np.bool_]:
    """Pixels of ``keep`` in patches of even depth that are so small that they may be chance."""
    if not keep.any():
        return keep
    # As 16-bit integers, for OpenCV: hundredths of a per cent, relative to the middle.
    steps, nothing = 1e4, np.iinfo(np.int16).min
    relative = np.log(np.where(keep, inverse_depth, 1)) - np.log(np.median(inverse_depth[keep]))
    depths = np.clip(np.round(relative * steps), -32_000, 32_000)
    patches = np.where(keep, depths, nothing).astype(np.int16)
    cv2.filterSpeckles(patches, float(nothing), round(_MAX_SPECK_SHARE * keep.size), _MAX_PATCH_STEP * steps)
    return np.asarray(keep & (patches == nothing))


def _edges(inverse_depth: Array) -> NDArray[np.bool_]:
    """Pixels at an occlusion edge: their windows cover two surfaces, their colours may be mixed."""
    kernel = np.ones((3, 3), np.uint8)
    return np.asarray(
        cv2.dilate(inverse_depth, kernel) - cv2.erode(inverse_depth, kernel) > _OCCLUSION_STEP * inverse_depth
    )


def _looseness(view: SweepView) -> Array:
    """Factor (H, W) of the distance between points: less where texture is strong."""
    contrast = view.contrast if view.recorded is None else view.contrast[view.recorded]
    typical = max(float(np.median(contrast)), 1e-6)
    return np.asarray(np.clip((view.contrast / typical) ** -_CONTRAST_EXPONENT, 1 / _SPACING_RANGE, _SPACING_RANGE))


def agree(
    views: Sequence[SweepView],
    index: int,
    neighbours: Sequence[int],
    matched: Sequence[int],
    depths: DepthMap,
    maps: Sequence[DepthMap | None],
) -> Candidates:
    """The points of one view's depth map that other views confirm.

    A confirmed point has the same depth in at least one view in ``neighbours`` (two, if it falls into four pictures; in
    one, so have the points around it), similar texture in the better half of the views in ``matched`` (the first of
    ``neighbours``) into whose pictures it falls, and no more views that see through it. Inverse depths are means over
    the consistent views.
    """
    view, own = views[index], depths.inverse_depth
    projections = [_project_surface(view, views[j], own) for j in neighbours]
    total, count, through = own.copy(), np.zeros(own.shape, np.float32), np.zeros(own.shape, np.float32)
    usable = np.zeros(own.shape, np.int64)
    for j, projection in zip(neighbours, projections, strict=True):
        depths_j = maps[j]
        if depths_j is None:
            continue
        usable += _within(views[j], projection.u, projection.v)
        seen = _sample(depths_j.inverse_depth, projection.u, projection.v, 0.0)
        valid = (seen > 0) & (projection.depth > 0) & _within(views[j], projection.u, projection.v)
        pixels = (projection.depth * seen - 1) * (_sideways(view, views[j]) / np.maximum(projection.depth, 1e-12))
        same = valid & (np.abs(pixels) <= _MAX_SHIFT_PIXELS)
        denominator = np.divide(1.0, seen, out=np.zeros_like(seen), where=same) - np.float32(projection.shift)
        same &= denominator > 0
        total += np.divide(projection.base, denominator, out=np.zeros_like(seen), where=same)
        count += same
        through += valid & (pixels < -3 * _MAX_SHIFT_PIXELS)
    inverse_depth = total / (count + 1)
    score = _better_half(_similarities(view, [views[j] for j in matched], projections[: len(matched)]))
    keep = (count >= np.where(usable >= 4, 2, 1)) & (score >= _MIN_TEXTURE_CORRELATION) & (through <= count)
    keep &= (inverse_depth > 1e-12) & ~_edges(own)
    if view.recorded is not None:
        keep &= view.recorded
    keep &= (count >= 2) | ~_specks(keep, inverse_depth)
    row, column = np.nonzero(keep)
    inverse = inverse_depth[keep]
    depth = 1 / inverse.astype(np.float64)
    rays = pixel_rays(view, column.astype(np.float64), row.astype(np.float64))
    return Candidates(
        xyz=view.centre + rays * depth[:, None],
        rgb=view.picture[keep],
        spacing=(depth / view.focal * _looseness(view)[keep]).astype(np.float32),
        confidence=(np.clip(score, 0, 1) * count / (count + 1))[keep],
        inverse_depth=inverse,
        column=column,
        row=row,
    )


def _sideways(view: SweepView, other: SweepView) -> float:
    """Displacement in the other view, in pixels, of a point at unit depth per relative change of its depth."""
    offset = other.centre - view.centre
    along = float(offset @ other.rotation[2])
    return float(other.focal * np.sqrt(max(float(offset @ offset) - along**2, 0.0)))


def depth_ratio(
    view: SweepView, inverse_depth: Array, xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Depth of points (P, 3) over the depth seen there (> 1: hidden; NaN where unknown, 0), their columns and rows."""
    u, v, z = project(view, xyz)
    visible = inside(view, u, v) & (z > 0)
    column = np.where(visible, np.round(u), 0).astype(np.int64)
    row = np.where(visible, np.round(v), 0).astype(np.int64)
    seen = inverse_depth[row, column]
    return np.where(visible & (seen > 0), seen * z, np.nan), column, row
