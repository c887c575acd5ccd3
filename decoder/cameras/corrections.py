"""What a rig camera recorded, from what the scene shows: its exposure, white balance and pose in that frame.

The reverse of what the encoder takes out of the pictures; the numbers are ``decogs.codec.packets.corrections``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import FALLOFF_STEP, Correction
from decogs.formats.cameras import Camera, as_pinhole, ray_slopes, turned
from decogs.formats.splats import FloatArray

from ..rasterise.straight_alpha import straight_colours
from .lamps import lamp_light
from .lens import undistort_pixels

if TYPE_CHECKING:
    from ..rasterise import Rendering


def as_it_stood(camera: Camera, correction: Correction) -> Camera:
    """The camera, turned about its centre as it was in the frame; the same object when it was not."""
    if not correction.is_turned:
        return camera
    pose = camera.world_to_camera.copy()
    # Rows of turned(R, v) are R v, so turning the columns of the pose turns what it gives.
    pose[:3] = turned(correction.rotation.T, camera.world_to_camera[:3].T).T
    return replace(camera, world_to_camera=pose)


_BAND_ROWS = 64
"""Rows for which fall-off and lamps are computed at a time: its doubles are many times a picture's floats."""


def as_recorded(colours: FloatArray, correction: Correction, camera: Camera, *, undo: bool = False) -> FloatArray:
    """The scene's ``colours`` (H, W, 3) as the ``camera``, its lens included, recorded them; ``undo``: the reverse.

    Source: SPEC.md, "Corrections".
    """
    gain = np.asarray(correction.odds_gain)
    if not (correction.falloff or correction.has_wave):
        return apply_gain(colours, 1 / gain if undo else gain)
    recorded = np.empty_like(colours)
    across = (np.arange(camera.width)[None] + 0.5) / camera.width
    for top in range(0, camera.height, _BAND_ROWS):
        band = range(top, min(top + _BAND_ROWS, camera.height))
        factors = gain * darkening(correction, camera, band)[..., None] if correction.falloff else gain
        if correction.has_wave:
            factors = factors * lamp_light(correction, across, (np.array(band)[:, None] + 0.5) / camera.height)
        recorded[band.start : band.stop] = apply_gain(colours[band.start : band.stop], 1 / factors if undo else factors)
    return recorded


def darkening(correction: Correction, camera: Camera, band: range | None = None) -> FloatArray:
    """Share of the light that fall-off leaves at each pixel (H, W) of the camera's picture; 1 where its lens ends.

    ``band``: of these rows; all if not given.
    """
    rows, columns = np.meshgrid(band or range(camera.height), range(camera.width), indexing="ij")
    rows, columns = rows + 0.5, columns + 0.5
    pixels = undistort_pixels(camera, np.stack([columns, rows], axis=-1))
    x, y = ray_slopes(as_pinhole(camera), pixels[..., 0], pixels[..., 1])
    with np.errstate(invalid="ignore"):
        left = (1 + correction.falloff * FALLOFF_STEP * (x * x + y * y)) ** -2
    return np.asarray(np.where(np.isfinite(left), left, 1), np.float32)


def apply_gain(colours: FloatArray, odds_gain: tuple[float, float, float] | NDArray[np.floating]) -> FloatArray:
    """(..., 3) display-referred colours whose odds v / (1 - v) are multiplied per channel; new, same dtype.

    Black and white stay, and so does what lies beyond them. Source: SPEC.md, "Corrections".
    """
    factors = np.asarray(odds_gain, colours.dtype)
    inside = np.clip(colours, 0, 1)
    # Rounding may take white a little beyond itself.
    multiplied = np.minimum(factors * inside / (1 + (factors - 1) * inside), 1)
    return np.where(colours == inside, multiplied, colours)


def with_recorded_colours(
    seen: Rendering, camera: Camera, correction: Correction, behind: tuple[float, float, float] | None
) -> Rendering:
    """The rendering with the camera's exposure, white balance, fall-off and lamps; the same object when it has none.

    ``camera``: of the picture, its lens included. ``behind``: the colour that a subject is over, which stays as it is;
    None for a whole scene.
    """
    if not correction.is_coloured:
        return seen
    if behind is None:
        return replace(seen, image=as_recorded(seen.image, correction, camera))
    covered = seen.alpha[..., None]
    rest = (1 - covered) * np.asarray(behind, np.float32)
    own = as_recorded(straight_colours(seen.image - rest, seen.alpha), correction, camera)
    return replace(seen, image=covered * own + rest)
