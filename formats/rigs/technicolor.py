"""Technicolor's light field videos: ``cameras_parameters.txt`` and ``SCENE_undist_FRAME_CAMERA.png``.

A header, then a line for each camera, numbered from 0: focal length, principal point (x, y), aspect, skew, rotation
(quaternion wxyz) and translation, world-to-camera in OpenCV axes; fy is focal length times aspect. Pictures are
undistorted and lie in the folder or in ``images/``. Pixel centres are at .5; the numbers are for pictures as they are.
Source: facebookresearch/hyperreel, datasets/technicolor.py; oppo-us-research/SpacetimeGaussians,
script/pre_technicolor.py.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import RigError
from .calibration import opencv_camera, quaternion_pose
from .fields import read_calibration_file
from .rig import Rig, assemble_rig
from .sources import FrameSource, list_folder, open_pictures, pictures_in, refuse_unknown_kinds

LAYOUT = "technicolor"
CALIBRATION = "cameras_parameters.txt"
_NUMBERS = 12
_PICTURE = re.compile(r".*_([0-9]+)_([0-9]+)")


def read_technicolor(calibration: Path) -> Rig:
    """The rig in the folder of a cameras_parameters.txt. Raises RigError."""
    folder = calibration.parent
    rows = _rows(calibration)
    files = _pictures(folder)
    if not files:
        beside = (*list_folder(folder), *list_folder(folder / "images"))
        refuse_unknown_kinds(entry for entry in beside if _PICTURE.fullmatch(entry.stem))
        raise RigError(f"{folder}: no pictures such as Scene_undist_00100_00.png, here or in images/; put them there")
    if sorted(files) != list(range(len(rows))):
        raise RigError(
            f"{calibration}: {len(rows)} cameras, but pictures of {len(files)} ({min(files):02d} to {max(files):02d}); "
            "put the missing pictures back or remove the line"
        )
    sources = {number: open_pictures(paths[0], paths) for number, paths in files.items()}
    pairs = [(_camera(number, rows[number], source, calibration), source) for number, source in sources.items()]
    return assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=False)


def _pictures(folder: Path) -> dict[int, list[Path]]:
    """The pictures by camera, in the order of their frames."""
    named = [(path, _PICTURE.fullmatch(path.stem)) for path in pictures_in(folder) or pictures_in(folder / "images")]
    files = sorted((int(name[2]), int(name[1]), path) for path, name in named if name is not None)
    return {camera: [path for number, _, path in files if number == camera] for camera in {row[0] for row in files}}


def _rows(path: Path) -> list[NDArray[np.float64]]:
    lines = read_calibration_file(path).decode("utf-8", errors="replace").splitlines()
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            row = np.array([float(word) for word in line.split()])
        except ValueError:
            row = np.zeros(1)
        if row.size and (row.size != _NUMBERS or not np.isfinite(row).all()):
            raise RigError(f"{path}: line {number} is not {_NUMBERS} finite numbers; correct the file")
        rows += [row] if row.size else []
    if not rows:
        raise RigError(f"{path}: holds no camera; the first line is a heading, and a line for each camera follows")
    return rows


def _camera(number: int, row: NDArray[np.float64], source: FrameSource, path: Path) -> Camera:
    where = f"{path}, camera {number}"
    focal, cx, cy, aspect, skew = row[:5]
    pose = quaternion_pose(row[5:9].tolist(), row[9:], where)
    matrix = [focal, skew, cx, 0, focal * aspect, cy, 0, 0, 1]
    return opencv_camera(f"cam{number:02d}", (source.width, source.height), matrix, (), pose, where, shift=0.0)
