"""Checks of arguments that all backends share; they raise ValueError."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import RowArray, checked_rows
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray

from .protocol import Drawable

_MAX_NEW_GAUSSIANS = 1 << 22
"""Highest row of a new Gaussian beyond the scene's last; the kernel has a place for each row up to it."""


def rows_of(moving: Drawable, rows: RowArray, population: int) -> RowArray:
    """The rows of Gaussians that change in a scene of ``population``: ascending, one for each."""
    if len(moving) != len(rows):
        raise ValueError(f"{len(moving)} Gaussians for {len(rows)} rows")
    return checked_rows(rows, population + _MAX_NEW_GAUSSIANS)


def check_marks(marks: NDArray[np.bool_] | None, camera: Camera) -> None:
    """Marks are one bool per pixel."""
    size = (camera.height, camera.width)
    if marks is not None and (marks.shape != size or marks.dtype != np.bool_):
        raise ValueError(f"marks of {marks.dtype} {marks.shape} for a picture of {size}")


def check_cotangents(size: tuple[int, int], v_rgb: FloatArray, *planes: FloatArray | None) -> None:
    """A cotangent has the shape of what it belongs to: colours (3, H, W), other ``planes`` (H, W)."""
    for cotangent, shape in ((v_rgb, (3, *size)), *((plane, size) for plane in planes)):
        if cotangent is not None and cotangent.shape != shape:
            raise ValueError(f"cotangent of shape {cotangent.shape} for a picture of {size}")
