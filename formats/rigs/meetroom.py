"""MeetRoom layout: ``cam_0.mp4`` to ``cam_12.mp4`` (not zero-padded) with ``poses_bounds.npy`` or a COLMAP model.

The published set has no calibration; mirrors carry one or the other. Rows of poses_bounds.npy are in natural order
(cam_2 before cam_10).
"""

from __future__ import annotations

import re
from pathlib import Path

from .colmap import read_colmap_rig
from .n3dv import read_poses_bounds_rig
from .rig import Rig

LAYOUT = "meetroom"
CAMERA_NAME = re.compile(r"cam_[0-9]+")


def read_meetroom(folder: Path, model: Path | None = None) -> Rig:
    """The rig in ``folder``, calibrated by the COLMAP ``model`` or else by poses_bounds.npy. Raises RigError."""
    if model is not None:
        return read_colmap_rig(folder, model, LAYOUT)
    return read_poses_bounds_rig(folder, LAYOUT, CAMERA_NAME)
