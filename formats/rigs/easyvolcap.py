"""EasyVolcap and EasyMocap layout: ``intri.yml``, ``extri.yml`` and ``images/CAM/`` or ``videos/CAM.mp4``.

Both files are OpenCV's FileStorage. ``K_CAM`` (3 x 3), ``D_CAM`` or ``dist_CAM`` (k1 k2 p1 p2 k3), ``H_CAM`` and
``W_CAM`` are in the one, ``R_CAM`` (Rodrigues) or ``Rot_CAM`` (3 x 3) and ``T_CAM`` in the other: world-to-camera in
OpenCV axes. Pixel centres are at .5: its rays pass there, and its converter from COLMAP copies the principal point.
Source: zju3dv/EasyVolcap, easyvolcap/utils/easy_utils.py, ray_utils.py (correct_pix) and scripts/colmap/.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..cameras import Camera
from ..errors import RigError
from .calibration import opencv_camera, vector_pose
from .file_storage import FileStorage
from .named_frames import frames_of_cameras
from .rig import Rig, assemble_rig
from .sources import FrameSource, open_source

LAYOUT = "easyvolcap"
CALIBRATION = "intri.yml"
_POSES = "extri.yml"


def read_easyvolcap(calibration: Path) -> Rig:
    """The rig whose intri.yml and extri.yml lie where ``calibration``, one of them, does. Raises RigError."""
    folder = calibration.parent
    intrinsics, poses = FileStorage(folder / CALIBRATION), FileStorage(folder / _POSES)
    names = intrinsics.keys_after("K_")
    if not names:
        raise RigError(f"{intrinsics.path}: no camera matrix K_00 or alike; calibrate the cameras")
    frames = frames_of_cameras(
        intrinsics.path, [folder / "images", folder / "videos", folder], {name: (name,) for name in names}
    )
    sources = {name: open_source(path) for name, path in frames.of.items()}
    pairs = [(_camera(name, source, intrinsics, poses), source) for name, source in sources.items()]
    rig = assemble_rig(folder, LAYOUT, pairs, [intrinsics.path, poses.path], resizable=True)
    unused = _unused(intrinsics, poses, names)
    return replace(rig, warnings=(*rig.warnings, *frames.warnings, *unused))


def _camera(name: str, source: FrameSource, intrinsics: FileStorage, poses: FileStorage) -> Camera:
    if any(intrinsics.matrix(f"rdist_{name}") if f"rdist_{name}" in intrinsics else ()):
        raise intrinsics.wrong(f"rdist_{name}", "is a fisheye's distortion, which is not read; undistort the pictures")
    # 0 and -1 stand for a size that nobody stated.
    width, height = (int(intrinsics.number(f"{side}_{name}", 0)) for side in "WH")
    size = (width, height) if width > 0 and height > 0 else (source.width, source.height)
    lens = next((key for key in (f"D_{name}", f"dist_{name}") if key in intrinsics), None)
    turn = f"R_{name}" if f"R_{name}" in poses or f"Rot_{name}" not in poses else f"Rot_{name}"
    where = f"{poses.path}, camera {name}"
    return opencv_camera(
        name,
        size,
        intrinsics.matrix(f"K_{name}", 9),
        () if lens is None else intrinsics.matrix(lens),
        vector_pose(poses.matrix(turn, 3, 9), poses.matrix(f"T_{name}", 3), where),
        f"{intrinsics.path}, camera {name}",
        shift=0.0,
    )


def _unused(intrinsics: FileStorage, poses: FileStorage, names: Sequence[str]) -> Iterator[str]:
    """What the files have that changes pictures or their times, and is not followed."""
    colours = [name for name in names if f"ccm_{name}" in intrinsics]
    if any(not np.allclose(intrinsics.matrix(f"ccm_{name}", 9).reshape(3, 3), np.eye(3)) for name in colours):
        yield f"{intrinsics.path}: colour matrices (ccm) are not used; apply them to the pictures"
    if any(poses.number(f"t_{name}", 0.0) for name in names):
        yield f"{poses.path}: the cameras' times (t) are not used; frames of one number are taken as one instant"
