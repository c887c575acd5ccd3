"""What nearly all pixels of a camera share when its exposure or white balance drifts, and no change of light does.

A gain of the camera multiplies every pixel's linear light; a lamp, a shadow or a screen changes some pixels more than
others, and leaves some as they are. So the gain of a frame against the first one is what at least 80 % of the picture
changed by, in one direction: between the 20th and the 80th percentile of the log ratios of small blocks, zero when
these differ in sign. And cameras drift apart, while the scene's light changes alike for all: only what a camera
differs by from what 80 % of the cameras share counts, as long as there are three to compare.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

EXPOSURE_LIMIT = 0.04
"""Gain on linear light from which exposure counts as drifting: 4 levels of 255 in a bright picture (a power of 1/2.2),
what the smallest change that is looked for in a scene amounts to."""

WHITE_BALANCE_LIMIT = 0.02
"""Gain of red or blue against green that counts: one level of 255 at mid-grey."""

FRAME_LIMIT = 0.01
"""Gain from which a frame of a drifting camera counts: half a level at mid-grey; a median over hundreds of blocks."""

_BLOCK = 8
_SHARED = 0.2
"""Share of the picture at either end that may do something else: what moves, a light of its own."""
_FEW = 20
"""Blocks below which nothing is said of a picture."""
_LINEAR: F32 = np.array(
    [v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in np.arange(256) / 255], np.float32
)
_CLIPPED = 5
"""Levels from either end of the scale within which a value tells nothing of the light."""
_CURVE_BINS = 16


@dataclass(frozen=True)
class CameraLight:
    """One camera's log gains against its first frame, (F, 3): over all channels, red over green, blue over green.

    ``shared``: what 80 % of the picture changed by at least; ``median``: by how much half of it did. NaN where a
    picture is too dark or too bright to tell. ``curves`` (F, 3, 256) float32: level to the level of the same light in
    frame 0.
    """

    shared: F64
    median: F64
    curves: F32


@dataclass(frozen=True)
class Light:
    """All cameras' gains, as log ratios, after what they have in common; arrays (cameras, F) unless said otherwise.

    ``exposure``, ``white_balance``: sizes of the gain that is the camera's own; ``gains`` (cameras, F, 3): medians over
    all channels, of red over green and of blue over green. ``compared``: whether there were cameras to compare with.
    """

    exposure: F64
    white_balance: F64
    gains: F64
    compared: bool
    _curves: tuple[F32, ...]

    def curves(self) -> list[F32 | None]:
        """Per camera, the curves that undo its drift; None for a camera that does not drift."""
        drifts = (_peaks(self.exposure) >= EXPOSURE_LIMIT) | (_peaks(self.white_balance) >= WHITE_BALANCE_LIMIT)
        return [curve if drift else None for curve, drift in zip(self._curves, drifts, strict=True)]


def without_drift(pictures: U8, curves: F32 | None) -> U8:
    """The pictures (F, H, W, 3) in the light of the first; the very same array when there are no ``curves`` (F, 3,
    256)."""
    if curves is None:
        return pictures
    steady = np.empty_like(pictures)
    for index, picture in enumerate(pictures):
        cv2.LUT(picture, np.rint(curves[index].T).astype(np.uint8)[None], dst=steady[index])
    return steady


def camera_light(pictures: U8) -> CameraLight:
    """The gains of one camera's pictures (F, H, W, 3) against the first."""
    first_light, first_levels = _blocks(pictures[0])
    shared, median = (np.full((len(pictures), 3), np.nan) for _ in range(2))
    curves = np.empty((len(pictures), 3, 256), np.float32)
    for index, picture in enumerate(pictures):
        light, levels = _blocks(picture)
        curves[index] = [_curve(levels[:, c], first_levels[:, c]) for c in range(3)]
        told = np.isfinite(light).all(axis=1) & np.isfinite(first_light).all(axis=1)
        if told.sum() < _FEW:
            continue
        ratio = np.log(light[told].astype(np.float64) / first_light[told])
        ratios = np.stack([ratio.mean(axis=1), ratio[:, 0] - ratio[:, 1], ratio[:, 2] - ratio[:, 1]], axis=1)
        shared[index], median[index] = _shared(ratios), np.median(ratios, axis=0)
    return CameraLight(shared, median, curves)


def steady_light(cameras: Sequence[CameraLight]) -> Light:
    """What of the cameras' gains is their own."""
    shared, median = (np.stack([getattr(camera, name) for camera in cameras]) for name in ("shared", "median"))
    compared = len(cameras) >= 3
    own = np.abs(shared)
    if compared:
        own = np.minimum(own, np.abs(shared - _common(shared)))
        gains = median - _common(median)
    else:
        gains = median
    return Light(own[..., 0], own[..., 1:].max(axis=2), gains, compared, tuple(camera.curves for camera in cameras))


def _blocks(picture: U8) -> tuple[F32, F32]:
    """Mean linear light and mean level of small blocks, both (blocks, 3); light is NaN where pixels are clipped."""
    height, width = (max(n // _BLOCK, 1) for n in picture.shape[:2])
    whole = np.ascontiguousarray(picture[: height * _BLOCK, : width * _BLOCK])
    size = (width, height)
    clipped = cv2.inRange(whole, (_CLIPPED,) * 3, (255 - _CLIPPED,) * 3) == 0
    light = cv2.resize(_LINEAR[whole], size, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    levels = cv2.resize(whole.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    share = cv2.resize(clipped.astype(np.float32), size, interpolation=cv2.INTER_AREA).reshape(-1)
    return np.where(share[:, None] > 0.1, np.float32(np.nan), light), np.asarray(levels)


def _shared(ratios: F64) -> F64:
    low, high = np.quantile(ratios, [_SHARED, 1 - _SHARED], axis=0)
    nearer = np.where(np.abs(low) < np.abs(high), low, high)
    return np.asarray(np.where(low * high > 0, nearer, 0.0))


def _curve(now: F32, first: F32) -> F32:
    """Level now to level in the first frame (256,): medians of blocks by brightness, joined by straight lines."""
    order = np.argsort(now, kind="stable")
    groups = [group for group in np.array_split(order, _CURVE_BINS) if len(group)]
    at = [float(np.median(now[group])) for group in groups]
    offset = [float(np.median(first[group] - now[group])) for group in groups]
    levels = np.arange(256, dtype=np.float64)
    return np.clip(levels + np.interp(levels, at, offset), 0, 255).astype(np.float32)


def _common(values: F64) -> F64:
    """What 80 % of the cameras that tell something share at least, as blocks do; 0 where they differ in sign."""
    told = np.isfinite(values)
    return _shared(np.where(told, values, 0.0))


def _peaks(values: F64) -> F64:
    return np.asarray(np.nan_to_num(values, nan=0.0).max(axis=1))
