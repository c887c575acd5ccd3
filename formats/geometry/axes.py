"""Where the cameras of a rig look together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera, camera_centre

_PARALLEL = 1e-4
"""Ratio of the least to the most that the axes pin the point down, below which they are parallel: half a degree."""


def point_nearest_axes(cameras: Sequence[Camera]) -> tuple[NDArray[np.float64], bool]:
    """The point (3,) nearest to all optical axes in the least squares, and whether it is the only one.

    Parallel axes pass each other nowhere: then it is one of many.
    """
    centres = np.array([camera_centre(camera) for camera in cameras])
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None]
    point, _, rank, _ = np.linalg.lstsq(
        across.sum(axis=0), (across * centres[:, None]).sum(axis=(0, 2)), rcond=_PARALLEL
    )
    return np.asarray(point), int(rank) == 3
