"""What moves in each half-plane through the line between two cameras: a signal that both see alike at one instant.

The plane through two cameras' centres and a point in space cuts both pictures; what moves in it moves in both, whatever
else they see. So the motion on a pair's epipolar lines over time is compared without matching a single feature, for
cameras as far apart as opposite each other. Source: Ben-Artzi et al., Camera calibration from dynamic silhouettes using
motion barcodes, CVPR 2016; here energies instead of bits, and half-planes instead of lines.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import undistort_pixels
from decogs.formats.cameras import Camera, camera_centre, ray_slopes

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

PLANES = 160
"""Half-planes of a pair, of one angle each."""
CHANNELS = 2
"""Change of brightness, which shows a flame or a flash, and change of structure, which a change of light does not."""
_PARTNERS = 10
"""Cameras, of nearest viewing direction, that each one is compared with."""
_MIN_WEDGE = np.radians(5)
"""Angle that both cameras of a pair must see to be compared."""
_CELL = 2
"""Pixels, across and down, whose motion is summed before it is told apart."""
_BLUR = 1.5
"""Deviation of the blur, in pixels, that takes noise from pictures."""
_WINDOW = (15, 15)
_NOISE = 6.0
"""Change that counts, in multiples of the usual change of a pixel ..."""
_MIN_LEVELS, _MIN_STRUCTURE = 2.0, 0.15
"""... and at the least, in levels and in deviations of the pixels around."""
_CONTRAST_FLOOR = 4.0
"""Levels of contrast below which structure is noise."""

Planes = Mapping[tuple[int, int], tuple[I64, I64]]
"""By pair of cameras, the half-plane of every cell of each one's picture; PLANES where the other cannot see it."""


def planes_of(cameras: Sequence[Camera]) -> Planes:
    """The half-planes of every camera and its partners."""
    pairs = ((pair, _pair_planes(cameras[pair[0]], cameras[pair[1]])) for pair in _partners(cameras))
    return {pair: planes for pair, planes in pairs if planes is not None}


def signals_of(row: int, planes: Planes, pictures: Iterable[U8]) -> dict[int, F32]:
    """By partner, the motion (CHANNELS, F - 1, PLANES) in a camera's grey ``pictures`` (H, W) from each to the next."""
    own = {(two if one == row else one): pair[one != row] for (one, two), pair in planes.items() if row in (one, two)}
    changes = [_changes(*pair) for pair in pairwise(map(_normalised, pictures))]
    signals = {partner: np.zeros((CHANNELS, len(changes), PLANES), np.float32) for partner in own}
    for channel, least in enumerate((_MIN_LEVELS, _MIN_STRUCTURE)):
        usual = float(np.median([np.median(frame[channel]) for frame in changes])) if changes else 0.0
        limit = max(least, _NOISE * usual)
        for at, frame in enumerate(changes):
            energy = np.sqrt(np.maximum(frame[channel].ravel().astype(np.float32) - limit, 0))
            moving = np.flatnonzero(energy)
            for partner, cells in own.items():
                signals[partner][channel, at] = np.bincount(cells[moving], energy[moving], PLANES + 1)[:PLANES]
    return signals


def _partners(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    alike = axes @ axes.T
    np.fill_diagonal(alike, -np.inf)
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, : min(_PARTNERS, len(cameras) - 1)]
    return sorted(
        {(min(row, other), max(row, other)) for row in range(len(cameras)) for other in nearest[row].tolist()}
    )


def _pair_planes(one: Camera, two: Camera) -> tuple[I64, I64] | None:
    """The half-plane (cells,) of every cell of both cameras; None where they share too little, or a place."""
    baseline = camera_centre(two) - camera_centre(one)
    length = float(np.linalg.norm(baseline))
    if length < 1e-9:
        return None
    along = baseline / length
    # Angles are counted from what both look at, so that they jump behind the cameras.
    ahead = one.world_to_camera[2, :3] + two.world_to_camera[2, :3]
    ahead = ahead - along * (ahead @ along)
    if np.linalg.norm(ahead) < 1e-3:
        ahead = np.cross(along, one.world_to_camera[0, :3])
    ahead = ahead / np.linalg.norm(ahead)
    angles = [_angles(camera, ahead, np.cross(along, ahead)) for camera in (one, two)]
    # Without the outermost cells: a lens may bend them anywhere.
    low = max(float(np.nanpercentile(each, 1)) for each in angles)
    high = min(float(np.nanpercentile(each, 99)) for each in angles)
    if high - low < _MIN_WEDGE:
        return None
    numbers = [np.floor((each - low) / (high - low) * PLANES) for each in angles]
    first, second = (np.where((n >= 0) & (n < PLANES), n, PLANES).astype(np.int64) for n in numbers)
    return first, second


def _angles(camera: Camera, ahead: F64, aside: F64) -> F64:
    """The angle (cells,), about the baseline, in which each cell looks; NaN where the lens shows nothing."""
    width, height = camera.width // _CELL, camera.height // _CELL
    u, v = (np.arange(n) + 0.5 for n in (width, height))
    columns, rows = np.meshgrid(u * camera.width / width, v * camera.height / height)
    straight = undistort_pixels(camera, np.stack([columns.ravel(), rows.ravel()], axis=1))
    x, y = ray_slopes(camera, straight[:, 0], straight[:, 1])
    rays = np.stack([x, y, np.ones_like(x)], axis=1) @ camera.world_to_camera[:3, :3]
    return np.asarray(np.arctan2(rays @ aside, rays @ ahead))


def _normalised(picture: U8) -> tuple[F32, F32]:
    """A grey picture without noise, in levels, and the same against the mean and contrast around each pixel."""
    levels = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _BLUR)
    mean = cv2.blur(levels, _WINDOW)
    contrast = np.maximum(cv2.blur(levels * levels, _WINDOW) - mean * mean, 0)
    return np.asarray(levels), np.asarray((levels - mean) / np.sqrt(contrast + _CONTRAST_FLOOR**2))


def _changes(before: tuple[F32, F32], now: tuple[F32, F32]) -> list[NDArray[np.float16]]:
    """The change of every cell (rows, columns), of either kind."""
    return [_cells(cv2.absdiff(one, two)).astype(np.float16) for one, two in zip(before, now, strict=True)]


def _cells(plane: NDArray[np.generic]) -> F32:
    size = plane.shape[1] // _CELL, plane.shape[0] // _CELL
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_AREA), np.float32)  # type: ignore[arg-type]
