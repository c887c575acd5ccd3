"""What a rig camera recorded, from what the scene shows: its exposure, white balance and pose in that frame.

The reverse of what the encoder takes out of the pictures; the numbers are ``decogs.codec.packets.corrections``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from decogs.codec.packets.corrections import Correction
from decogs.formats.cameras import Camera, turned
from decogs.formats.splats import FloatArray

from ..rasterise.straight_alpha import straight_colours

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


def apply_gain(colours: FloatArray, odds_gain: tuple[float, float, float]) -> FloatArray:
    """(..., 3) display-referred colours whose odds v / (1 - v) are multiplied per channel; new, same dtype.

    Black and white stay, and so does what lies beyond them. Source: SPEC.md, "Corrections".
    """
    factors = np.asarray(odds_gain, colours.dtype)
    inside = np.clip(colours, 0, 1)
    # Rounding may take white a little beyond itself.
    multiplied = np.minimum(factors * inside / (1 + (factors - 1) * inside), 1)
    return np.where(colours == inside, multiplied, colours)


def with_recorded_colours(
    seen: Rendering, correction: Correction, behind: tuple[float, float, float] | None
) -> Rendering:
    """The rendering with the camera's exposure and white balance; the same object when it has none.

    ``behind``: the colour that a subject is over, which stays as it is; None for a whole scene.
    """
    if not correction.is_coloured:
        return seen
    if behind is None:
        return replace(seen, image=apply_gain(seen.image, correction.odds_gain))
    covered = seen.alpha[..., None]
    rest = (1 - covered) * np.asarray(behind, np.float32)
    own = apply_gain(straight_colours(seen.image - rest, seen.alpha), correction.odds_gain)
    return replace(seen, image=covered * own + rest)
