"""Changed pixels between two pictures of a camera, divided into changes of light and of content.

A change of light is an affine function of the old values in every small window: brighter, darker, of more or less
contrast. Motion is not. So affine fits map the new picture to the old one and vice versa, in windows of 7 x 7 pixels.
Where the residual exceeds half of the change, the content differs: *restructured*.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..change.masks import BoolArray, dilate

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

CHANGE_LEVELS = 4.0
"""Smallest change of a 3 x 3 mean that counts, in 8-bit levels; at least CHANGE_NOISE times the camera's noise."""
CHANGE_NOISE = 4.0
_RESTRUCTURED_LEVELS = 6.0
"""Least residual of an affine fit that counts, in levels: video coding leaves 2 to 3 at sharp texture."""
_RESIDUAL_SHARE = 0.5
_FIT_WINDOW = (7, 7)
WINDOW_PIXELS = 49
_NEAR_RADIUS_WIDTHS = 0.0355
"""Radius around restructured pixels within which a change belongs to them, as a share of the picture's width: the
dilation of the encoder's masks."""


@dataclass(frozen=True)
class ChangeMaps:
    """Bool (H, W): ``changed``; ``restructured``, changes that no affine change of light explains."""

    changed: BoolArray
    restructured: BoolArray

    def around(self, width: int) -> BoolArray:
        """Pixels in and around restructured ones; ``width``: of the whole picture, of which the maps may be a part."""
        return dilate(self.restructured, round(_NEAR_RADIUS_WIDTHS * width))


def change_maps(before: U8, now: U8, noise: float) -> ChangeMaps:
    """Changes from one picture (H, W, 3) to the next; ``noise``: deviation of one picture in 8-bit levels."""
    limit = max(CHANGE_LEVELS, CHANGE_NOISE * noise)
    changed = _largest_difference(cv2.blur(before, (3, 3)), cv2.blur(now, (3, 3))) > limit
    if not changed.any():
        return ChangeMaps(changed, changed)
    left_over, energy = _left_over(before, now)
    least = max(_RESTRUCTURED_LEVELS, CHANGE_NOISE * noise) ** 2
    return ChangeMaps(changed, changed & (left_over > least) & (left_over > _RESIDUAL_SHARE * energy))


def _largest_difference(before: NDArray[Any], now: NDArray[Any]) -> U8:
    """The largest difference of a channel, of every pixel (H, W); numpy's own reduction over so short an axis takes ten
    times as long."""
    red, green, blue = cv2.split(cv2.absdiff(now, before))
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def _left_over(before: U8, now: U8) -> tuple[F32, F32]:
    """Mean squared residual of affine fits in the window around each pixel, and mean squared change."""
    first, second = (cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, now))
    means = [cv2.boxFilter(grey, cv2.CV_32F, _FIT_WINDOW) for grey in (first, second)]
    squares = [cv2.sqrBoxFilter(grey, cv2.CV_32F, _FIT_WINDOW) for grey in (first, second)]
    was, became = (square - mean * mean for square, mean in zip(squares, means, strict=True))
    product = cv2.blur(cv2.multiply(first, second, dtype=cv2.CV_32F), _FIT_WINDOW)
    # The negative of a pattern counts as different content.
    common = np.maximum(product - means[0] * means[1], 0) ** 2
    left_over = np.maximum(became - common / (was + 1), was - common / (became + 1))
    return left_over, squares[0] + squares[1] - 2 * product
