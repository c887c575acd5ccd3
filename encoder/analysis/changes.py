"""Changed pixels between two pictures of a camera, divided into changes of light and of content.

A change of light is an affine function of the old values in every small window: brighter, darker, of more or less
contrast. Motion is not. So affine fits map the new picture to the old one and vice versa, in windows of 7 x 7 pixels.
Where the residual exceeds half of the change, the content differs: *restructured*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from ..change.masks import BoolArray, dilate

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
P = TypeVar("P", bound="np.integer[Any] | np.floating[Any]")

CHANGE_LEVELS = 4.0
"""Smallest change of a 3 x 3 mean that counts, in 8-bit levels; at least CHANGE_NOISE times the camera's noise."""
CHANGE_NOISE = 4.0
_RESTRUCTURED_LEVELS = 6.0
"""Least residual of an affine fit that counts, in levels: video coding leaves 2 to 3 at sharp texture."""
_UNEXPLAINED = 0.5
_WINDOW = (7, 7)
WINDOW_PIXELS = 49
SLOW_FRAMES = 4
"""Frames over which slow light is detected, which changes by less than CHANGE_LEVELS per frame."""
_MIN_PART = 0.5
"""Least part of a frame in such a change, relative to an even distribution over the frames."""
NEAR_FRACTION = 0.0355
"""Radius around restructured pixels within which a change belongs to them, as a share of the picture's width: the
dilation of the encoder's masks."""


@dataclass(frozen=True)
class ChangeMaps:
    """Bool (H, W): ``changed``; ``restructured``, changes that no affine change of light explains."""

    changed: BoolArray
    restructured: BoolArray

    def around(self, width: int | None = None) -> BoolArray:
        """Pixels in and around restructured ones; ``width``: of the whole picture, if the maps are of a part."""
        return dilate(self.restructured, round(NEAR_FRACTION * (width or self.changed.shape[1])))

    def near(self, width: int | None = None) -> BoolArray:
        """Changed pixels around restructured ones: objects, their shadows, uncovered background.

        ``width``: of the whole picture, if the maps are of a part.
        """
        return self.changed & self.around(width)


@dataclass(frozen=True)
class ChangeShares:
    """Shares of one camera's picture per frame (F,), against the frame before; NaN for the first.

    ``changed``, ``restructured``, and ``near``: changed pixels close to restructured ones. ``slow_changed``,
    ``slow_near``: the same over the SLOW_FRAMES frames around a frame that contributes to their change, else 0; NaN
    for a camera whose drift was removed.
    """

    changed: F64
    restructured: F64
    near: F64
    slow_changed: F64
    slow_near: F64

    @staticmethod
    def undetermined(frames: int) -> ChangeShares:
        """The shares of a camera that cannot be judged: NaN for each of its ``frames``."""
        return ChangeShares(*(np.full(frames, np.nan) for _ in fields(ChangeShares)))

    @staticmethod
    def of(frames: Sequence[ChangeMaps], pictures: U8, noise: float, *, slow: bool = True) -> ChangeShares:
        """The shares of a camera's frames, ``frames`` being the maps of all but the first of its ``pictures``.

        ``slow``: whether slow light can be detected at all.
        """
        maps = {"changed": [m.changed for m in frames], "restructured": [m.restructured for m in frames]}
        maps["near"] = [m.near() for m in frames]
        shares = {name: np.array([np.nan, *(float(m.mean()) for m in found)]) for name, found in maps.items()}
        slow_changed, slow_near = _slow_shares(pictures, noise) if slow else np.full((2, len(pictures)), np.nan)
        return ChangeShares(**shares, slow_changed=slow_changed, slow_near=slow_near)


def change_maps(before: U8, now: U8, noise: float) -> ChangeMaps:
    """Changes from one picture (H, W, 3) to the next; ``noise``: deviation of one picture in 8-bit levels."""
    return _change_maps(_Look(before), _Look(now), noise)


def successive_changes(pictures: U8, noise: float) -> list[ChangeMaps]:
    """The `change_maps` of each picture (F, H, W, 3) and the one before it."""
    return [_change_maps(before, now, noise) for before, now in pairwise(map(_Look, pictures))]


@dataclass(frozen=True)
class _Look:
    """A picture (H, W, 3) and what is compared of it, each worked out once: with the last picture and with the next."""

    picture: U8

    @cached_property
    def smooth(self) -> U8:
        return np.asarray(cv2.blur(self.picture, (3, 3)), np.uint8)

    @cached_property
    def grey(self) -> U8:
        return np.asarray(cv2.cvtColor(self.picture, cv2.COLOR_RGB2GRAY), np.uint8)

    @cached_property
    def mean(self) -> F32:
        return np.asarray(cv2.boxFilter(self.grey, cv2.CV_32F, _WINDOW), np.float32)

    @cached_property
    def square(self) -> F32:
        return np.asarray(cv2.sqrBoxFilter(self.grey, cv2.CV_32F, _WINDOW), np.float32)

    @cached_property
    def variance(self) -> F32:
        return np.asarray(self.square - self.mean * self.mean)


def _change_maps(before: _Look, now: _Look, noise: float) -> ChangeMaps:
    limit = max(CHANGE_LEVELS, CHANGE_NOISE * noise)
    changed = largest_channel(cv2.absdiff(now.smooth, before.smooth)) > limit
    if not changed.any():
        return ChangeMaps(changed, changed)
    left_over, energy = _left_over(before, now)
    least = max(_RESTRUCTURED_LEVELS, CHANGE_NOISE * noise) ** 2
    return ChangeMaps(changed, changed & (left_over > least) & (left_over > _UNEXPLAINED * energy))


def largest_channel(picture: NDArray[P]) -> NDArray[P]:
    """The largest of the channels of every pixel (H, W); numpy's own reduction over so short an axis takes ten times as
    long."""
    red, green, blue = cv2.split(picture)
    return np.asarray(cv2.max(cv2.max(red, green), blue), picture.dtype)


def _slow_shares(pictures: U8, noise: float) -> F64:
    """``slow_changed`` and ``slow_near`` (2, F) of pictures (F, H, W, 3): light below noise between successive ones."""
    shares = np.zeros((2, len(pictures)))
    shares[:, 0] = np.nan
    last = len(pictures) - 1
    now = _Look(pictures[0])
    for end in sorted({*range(SLOW_FRAMES, last + 1, SLOW_FRAMES), last}) if last >= SLOW_FRAMES else ():
        span = pictures[end - SLOW_FRAMES : end + 1]
        before, now = now if end % SLOW_FRAMES == 0 else _Look(span[0]), _Look(span[-1])
        maps = _change_maps(before, now, noise)
        near = maps.near()
        alone = maps.changed & ~near
        if not alone.any():
            continue
        values = span[:, alone].astype(np.float32)
        whole = values[-1] - values[0]
        parts = np.array([float(((after - before) * whole).sum()) for before, after in pairwise(values)])
        takes_part = parts >= _MIN_PART / SLOW_FRAMES * float((whole * whole).sum())
        shares[:, 1 + end - SLOW_FRAMES + np.flatnonzero(takes_part)] = [[maps.changed.mean()], [near.mean()]]
    return shares


def _left_over(before: _Look, now: _Look) -> tuple[F32, F32]:
    """Mean squared residual of affine fits in the window around each pixel, and mean squared change."""
    product = cv2.blur(cv2.multiply(before.grey, now.grey, dtype=cv2.CV_32F), _WINDOW)
    # The negative of a pattern counts as different content.
    common = np.maximum(product - before.mean * now.mean, 0) ** 2
    left_over = np.maximum(now.variance - common / (before.variance + 1), before.variance - common / (now.variance + 1))
    return left_over, before.square + now.square - 2 * product
