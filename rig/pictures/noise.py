"""Noise of a camera from two of its pictures, robust to motion and changes of light.

Noise is independent between frames *and* between pixels. A Laplacian of the difference picture suppresses motion, which
is mostly smooth. Under a change of light, the new values in a small window are an affine function of the old ones: they
lie along a line, and noise is the spread across it, the smaller eigenvalue of their covariance, for any light and any
pattern. Both estimates only err upwards.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LAPLACIAN = np.array([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]], np.float32)
_SAMPLE_STRIDE, _SAMPLE_COUNT = 7, 100_000
"""Every seventh value is sampled, fewer above this count, which gives a deviation to .2 %."""
_TILE_PIXELS = 16
_MAX_TILES = 300
_QUIET_TILE_QUANTILE = 0.25
"""Quantile of the tiles' noise that counts as that of the picture: motion only raises a tile's."""
_CLIPPED_MARGIN_LEVELS = 3
_MAX_CLIPPED_SHARE = 0.1
_MAX_NOISE_RATIO = 1.5
"""Largest ratio of the picture's noise to that of its quietest tiles: video coding smooths flat tiles."""
_MAX_DEVIATION_RATIO = 2.0
"""Ratio of a difference's deviation to its noise from which on most of the picture has changed."""


def frame_noise(
    current: FloatArray,
    previous: FloatArray,
    negligible: float = 0.0,
    samples: int = _SAMPLE_COUNT,
    recorded: BoolArray | None = None,
) -> float:
    """Standard deviation of a camera's frame-to-frame noise, in 8-bit levels, robust to motion.

    Both (3, H, W). 0 if most of the picture has changed, which leaves noise undetermined.
    ``negligible``: deviation below which the result may be too large. ``samples``: values that suffice. ``recorded``:
    the pixels (H, W) that count, None meaning all.
    """
    deviation = _robust_deviation(_sample(current, samples, recorded) - _sample(previous, samples, recorded))
    if deviation <= negligible:
        return deviation
    noise = picture_noise(previous, current, samples, recorded)
    return deviation if deviation <= _MAX_DEVIATION_RATIO * math.sqrt(2) * noise else 0.0


def picture_noise(
    before: FloatArray, now: FloatArray, samples: int = _SAMPLE_COUNT, recorded: BoolArray | None = None
) -> float:
    """Deviation of one picture by noise, in 8-bit levels, from two, (H, W) or (C, H, W), 0..1.

    ``recorded``: the pixels (H, W) that count, None meaning all.
    """
    before, now = (picture if picture.ndim == 3 else picture[None] for picture in (before, now))
    rows = _filtered_rows(before[0], samples)
    detail: FloatArray = np.stack([_laplacian(one, two, rows) for one, two in zip(before, now, strict=True)])
    inner = None if recorded is None else cv2.erode(recorded.astype(np.uint8), np.ones((3, 3), np.uint8))[rows] > 0
    from_neighbours = _robust_deviation(_sample(detail, samples, inner)) / math.sqrt(2 * float((_LAPLACIAN**2).sum()))
    across = _deviation_across_light(before, now, recorded)
    return from_neighbours if from_neighbours <= _MAX_NOISE_RATIO * across else across


def _sample(values: FloatArray, count: int, recorded: BoolArray | None) -> FloatArray:
    """Every seventh value (..., H, W) of what was ``recorded``, fewer of large pictures."""
    counted = values if recorded is None else values[..., recorded]
    return counted.ravel()[:: max(_SAMPLE_STRIDE, counted.size // count)]


def _filtered_rows(plane: FloatArray, samples: int) -> slice:
    """Enough rows of a plane (H, W) for so many samples; inner ones if not all."""
    stride = plane.size // (2 * samples)
    return slice(None) if stride < 2 else slice(1, len(plane) - 1, stride)


def _laplacian(before: FloatArray, now: FloatArray, rows: slice) -> FloatArray:
    """How the difference of two planes (H, W) differs from the mean of its neighbours, in these rows."""
    if rows == slice(None):
        return np.asarray(cv2.filter2D(now - before, -1, _LAPLACIAN), np.float32)
    # Each row between its neighbours; what is filtered around these is of no use.
    three = (np.arange(len(before))[rows, None] + np.arange(-1, 2)).ravel()
    return np.asarray(cv2.filter2D(now[three] - before[three], -1, _LAPLACIAN)[1::3], np.float32)


def _robust_deviation(difference: FloatArray) -> float:
    """Standard deviation of differences 0..1, in levels, without outliers beyond three deviations."""
    levels = difference.astype(np.float64) * 255
    # Starts from the median, which motion hardly shifts; in 8-bit pictures it is a whole level, often 0.
    deviation = 1.5 * float(np.median(np.abs(levels))) + 1
    for _ in range(20):
        kept = levels[np.abs(levels) <= 3 * deviation]
        smaller = float(np.sqrt(np.mean(kept**2))) if len(kept) else 0.0
        if smaller >= 0.999 * deviation:
            break
        deviation = smaller
    return deviation


def _deviation_across_light(before: FloatArray, now: FloatArray, recorded: BoolArray | None) -> float:
    """Deviation, in levels, across the lines of affine changes of light, in the quietest tiles; inf without any.

    Tiles count that were ``recorded`` as a whole.

    Rows and columns count as well: a wave of brightness may be finer than a tile.
    """
    a, b = _tiles(before), _tiles(now)
    channels = len(before)
    if recorded is not None:
        whole = np.tile((_tiles(recorded[None]) > 0).all(axis=(0, 1)), channels)
        a, b = a[..., whole], b[..., whole]
        if not whole.any():
            return math.inf
    clipped = ((np.minimum(a, b) < _CLIPPED_MARGIN_LEVELS) | (np.maximum(a, b) > 255 - _CLIPPED_MARGIN_LEVELS)).mean(
        axis=(0, 1)
    )
    usable = np.tile(clipped.reshape(channels, -1).mean(axis=0) < _MAX_CLIPPED_SHARE, channels)
    if not usable.any():
        return math.inf
    a, b = (np.compress(usable, tiles, axis=2) for tiles in (a, b))
    a, b = (tiles - tiles.mean(axis=(0, 1)) for tiles in (a, b))
    # Of rows and of columns; a tile's means are those of its rows' means.
    of_rows, of_columns = (
        np.stack([x.mean(axis=axis, dtype=np.float32) for x in (a, b, a * a, b * b, a * b)]).astype(np.float64)
        for axis in (1, 0)
    )
    least = np.minimum(_smaller_eigenvalue(of_rows).mean(axis=0), _smaller_eigenvalue(of_columns).mean(axis=0))
    least = np.minimum(least, _smaller_eigenvalue(of_rows.mean(axis=1))).reshape(channels, -1)
    return math.sqrt(max(float(np.quantile(least.mean(axis=0), _QUIET_TILE_QUANTILE)), 0.0))


def _tiles(picture: FloatArray | BoolArray) -> FloatArray:
    """Square tiles (side, side, C * N) of the picture (C, H, W), spread over it, in levels."""
    channels, height, width = picture.shape
    rows, columns = height // _TILE_PIXELS, width // _TILE_PIXELS
    step = max(1, math.isqrt(rows * columns // _MAX_TILES))
    whole = picture[:, : rows * _TILE_PIXELS, : columns * _TILE_PIXELS].reshape(
        channels, rows, _TILE_PIXELS, columns, _TILE_PIXELS
    )
    some = whole[:, ::step, :, ::step].transpose(2, 4, 0, 1, 3)
    # Tiles last: sums over a tile's pixels are then sums of long rows.
    return np.asarray(some.reshape(_TILE_PIXELS, _TILE_PIXELS, -1) * np.float32(255), np.float32)


def _smaller_eigenvalue(moments: F64) -> F64:
    """Of the covariance of two values whose means, mean squares and mean product are given (5, ...)."""
    mean_a, mean_b, square_a, square_b, product = moments
    a, b, covariance = square_a - mean_a * mean_a, square_b - mean_b * mean_b, product - mean_a * mean_b
    return np.asarray((a + b) / 2 - np.hypot((a - b) / 2, covariance))
