"""Cameras' colours matched: constant differences of exposure and white balance, found before anything is trained.

Cameras that show one surface in different colours make a keyframe hang haze before each of them: it is the only way in
which Gaussians can show every camera its own colours. The differences are found at the first points, which several
views confirm at one place whatever their brightness, and taken out of every frame's pictures. The header keeps them, so
that a rig camera's decoded view has the colours that it recorded.

Chosen over estimates while the keyframe is trained, as for drift: as good (`panoptic_basketball`, four cameras left
out: 25.3 dB as recorded, 26.9 either way), in 67 CPU-s instead of 81, without bytes in every frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import COLOUR_STEP, Correction, Corrections, whole_steps
from decogs.formats.cameras import project
from decogs.formats.splats import FloatArray
from decogs.rig.numerics import bilinear
from decogs.rig.pictures.ingest import View

from .agreement import shifts_of_points

_MIN_POINT_VIEWS = 3
"""Views of a point that counts: of two that differ, either may be the one that reflects a light."""


def find_colours(
    views: Sequence[View], pictures: Sequence[FloatArray], xyz: FloatArray, seen: NDArray[np.bool_]
) -> Corrections:
    """How every view's colours differ from the median view's, by camera; the cameras without a difference are left out.

    ``pictures``: (3, H, W) of every view. ``xyz`` (P, 3): points of the surface, which the views see where ``seen``
    (V, P). A view that shares too few of them with others has no difference.
    """
    counts = seen.sum(axis=0) >= _MIN_POINT_VIEWS
    points, seen = xyz[counts].astype(np.float64), seen[:, counts]
    values = np.stack([colours_at(view, picture, points) for view, picture in zip(views, pictures, strict=True)])
    shifts, has_overlap = shifts_of_points(values, seen)
    if not has_overlap.any():
        return {}
    own = np.where(has_overlap[:, None], shifts - np.median(shifts[has_overlap], axis=0), 0)
    corrections = {view.camera.name: _correction(shift) for view, shift in zip(views, own, strict=True)}
    return {name: correction for name, correction in corrections.items() if correction.is_coloured}


def colours_at(view: View, picture: FloatArray, points: NDArray[np.float64]) -> FloatArray:
    """The picture's colours (P, 3) around the points."""
    column, row, _ = project(view.pinhole, points)
    smooth = cv2.blur(picture.transpose(1, 2, 0), (3, 3))
    # A point that the view does not see may project anywhere, at infinity too.
    return bilinear(np.asarray(smooth, np.float32), *(np.clip(np.nan_to_num(at), -1, 32_767) for at in (column, row)))


def _correction(shift: NDArray[np.float64]) -> Correction:
    red, green, blue = shift.tolist()
    exposure, of_red, of_blue = (whole_steps(value, COLOUR_STEP) for value in (green, red - green, blue - green))
    return Correction(exposure, of_red, of_blue)
