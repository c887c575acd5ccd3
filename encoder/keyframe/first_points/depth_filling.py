"""Depths where a view has none, continued from the surfaces around.

Known depths continue as planes: a plane of the world has an inverse depth that is linear in the pixel's coordinates, so
that walls, floors and table tops go on beyond where two views see them.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.rig.mattes.filling import push_pull
from decogs.rig.numerics import floats

from .views import Array

F64 = NDArray[np.float64]

_HALF_WINDOW_WIDTHS = 0.05
"""Half the side of the window in which a plane is fitted, in units of the picture's width."""
_MAX_PLANE_DEVIATION = 0.01
"""Largest deviation of a window's inverse depths from their plane, relative to their mean: beyond it lies an edge."""
_WINDOW_KNOWN_FRACTION = 0.15
"""Least share of a window's pixels with known depths."""
_MIN_PLANES = 100
"""Pixels with a plane below which known depths continue as they are."""
_RIDGE_WEIGHT = 1e-3
"""Weight against slopes that few pixels in a row leave undetermined, relative to the window's own spread."""
_MAX_INVERSE_DEPTH_RATIO, _MIN_INVERSE_DEPTH_RATIO = 1.1, 0.95
"""Bounds of continued inverse depths, in units of the nearest and the farthest hundredth of the known ones."""

_FIELD_WIDTHS, _MIN_FIELD_PIXELS = 0.1, 8
"""Side of a chequerboard's field, in units of the picture's width, and in pixels at least."""
_MAX_DEPTH_DIFFERENCE = 0.02
"""Relative difference below which two continued depths agree."""
_MAX_REACH_WIDTHS = 0.1
"""Farthest that a plane is trusted to go on, in units of the picture's width."""


def fill_depths(inverse_depths: Array) -> Array:
    """Known inverse depths (H, W; 0: unknown), those of the planes around where there are none; (H, W).

    The far planes count a little stronger: behind the edge of a thing the background goes on.
    """
    planes, flat = _local_planes(inverse_depths)
    if np.count_nonzero(flat) < _MIN_PLANES:
        return push_pull(inverse_depths[..., None], _weights(inverse_depths))[..., 0]
    planes = push_pull(planes, np.where(flat, _weights(inverse_depths), 0))
    u, v = _coordinates(inverse_depths.shape)
    nearest, farthest = np.percentile(inverse_depths[inverse_depths > 0], [99, 1])
    continued = floats(planes[..., 0] * u + planes[..., 1] * v + planes[..., 2])
    return np.where(
        inverse_depths > 0,
        inverse_depths,
        np.clip(continued, floats(_MIN_INVERSE_DEPTH_RATIO * farthest), floats(_MAX_INVERSE_DEPTH_RATIO * nearest)),
    )


def continues(inverse_depths: Array) -> NDArray[np.bool_]:
    """Pixels (H, W) in which known inverse depths (H, W; 0: unknown) go on as planes, near known ones.

    Each of two halves of the known depths, the fields of a chequerboard, says how they go on; where they agree, planes
    are what is there.
    """
    reach = round(_MAX_REACH_WIDTHS * inverse_depths.shape[1])
    near = cv2.dilate((inverse_depths > 0).astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0
    row, column = np.indices(inverse_depths.shape) // max(
        _MIN_FIELD_PIXELS, round(_FIELD_WIDTHS * inverse_depths.shape[1])
    )
    dark = (row + column) % 2 == 1
    halves = np.where(dark, inverse_depths, 0), np.where(dark, 0, inverse_depths)
    if not all(half.any() for half in halves):
        return np.zeros(inverse_depths.shape, np.bool_)
    one, other = (np.maximum(fill_depths(half), np.float32(1e-12)) for half in halves)
    return np.asarray(near & (np.abs(np.log(one / other)) < _MAX_DEPTH_DIFFERENCE))


def _weights(inverse_depths: Array) -> Array:
    weights = np.divide(1, inverse_depths, out=np.zeros_like(inverse_depths), where=inverse_depths > 0)
    return np.asarray(weights / max(float(weights.max()), 1e-12))


def _coordinates(shape: tuple[int, ...]) -> tuple[F64, F64]:
    """Columns (1, W) and rows (H, 1) from the middle of the picture, in units of its width."""
    height, width = shape
    return (np.arange(width)[None] - width / 2) / width, (np.arange(height)[:, None] - height / 2) / width


def _local_planes(inverse_depths: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Planes (a, b, c), (H, W, 3), of inverse depth a u + b v + c fitted to a window around every pixel.

    Also the pixels (H, W) that have a known depth and a window that is flat.
    """
    u, v = _coordinates(inverse_depths.shape)
    reach = max(3, round(_HALF_WINDOW_WIDTHS * inverse_depths.shape[1]))
    mask, depth = (inverse_depths > 0).astype(np.float64), inverse_depths.astype(np.float64)
    share = np.maximum(_window_mean(mask, reach), 1e-9)

    def mean(values: F64) -> F64:
        return _window_mean(values * mask, reach) / share

    mean_u, mean_v, middle = mean(u + 0 * v), mean(v + 0 * u), mean(depth)
    ridge = _RIDGE_WEIGHT * (reach / inverse_depths.shape[1]) ** 2
    uu, vv = mean(u * u + 0 * v) - mean_u**2 + ridge, mean(v * v + 0 * u) - mean_v**2 + ridge
    uv, ud, vd = mean(u * v) - mean_u * mean_v, mean(u * depth) - mean_u * middle, mean(v * depth) - mean_v * middle
    determinant = uu * vv - uv * uv
    a, b = (vv * ud - uv * vd) / determinant, (uu * vd - uv * ud) / determinant
    left = np.maximum(mean(depth * depth) - middle**2 - a * ud - b * vd, 0)
    flat = (inverse_depths > 0) & (share > _WINDOW_KNOWN_FRACTION) & (np.sqrt(left) < _MAX_PLANE_DEVIATION * middle)
    return np.stack([a, b, middle - a * mean_u - b * mean_v], axis=-1).astype(np.float32), flat


def _window_mean(values: F64, reach: int) -> F64:
    return np.asarray(cv2.boxFilter(values, cv2.CV_64F, (2 * reach + 1,) * 2, borderType=cv2.BORDER_CONSTANT))
