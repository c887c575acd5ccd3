"""nerfstudio / instant-ngp layout: ``transforms.json`` whose entries are the fixed cameras of a rig.

``frames[].file_path`` names a video, a folder of pictures, or one picture per entry; several picture entries with the
same folder and pose are the frames of one camera, ordered by ``time`` and name. Intrinsics (fl_x, fl_y, cx, cy, w, h,
or camera_angle_x) are global or per entry; k1 k2 k3 p1 p2 follow OpenCV, and k1..k4 with camera_model OPENCV_FISHEYE.
transform_matrix is camera-to-world in OpenGL axes (x right, y up, z backwards). Pixel centres are at .5.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..cameras import Camera, DistortionModel
from ..errors import RigError
from ..pictures import PICTURE_SUFFIXES
from .calibration import calibrated_camera, invert_pose, rigid_pose
from .json_fields import Fields, read_json
from .rig import Rig, assemble_rig
from .sources import GENERIC_FOLDERS, FrameSource, natural_key, open_pictures, open_source

LAYOUT = "nerfstudio"
CALIBRATION = "transforms.json"
_PINHOLE = frozenset({"PINHOLE", "SIMPLE_PINHOLE"})
_OPENCV = frozenset({"OPENCV", "RADIAL", "SIMPLE_RADIAL"})


@dataclass(frozen=True)
class _Entry:
    """One element of frames[]: its own fields over the file's, and where its pictures are."""

    fields: Fields
    path: Path
    time: float


def read_nerfstudio(folder: Path) -> Rig:
    """The rig described by ``folder``/transforms.json. Raises RigError."""
    fields = read_json(folder / CALIBRATION)
    shared = {key: value for key, value in fields.values.items() if key != "frames"}
    entries = [_entry(folder, replace(own, values={**shared, **own.values})) for own in fields.records("frames")]
    groups = _group_by_camera(entries)
    names = _camera_names(groups)
    if all(len(group) == 1 for group in groups) and len({entry.time for entry in entries}) > 1:
        raise RigError(
            f"{folder / CALIBRATION}: every entry has its own pose and time, as of a moving camera; "
            "a rig needs fixed cameras that all see every frame"
        )
    pairs = []
    for name, group in zip(names, groups, strict=True):
        source = _source(group)
        pairs.append((_camera(name, group[0].fields, source), source))
    return assemble_rig(folder, LAYOUT, pairs, [folder / CALIBRATION], resizable=True)


def _entry(folder: Path, fields: Fields) -> _Entry:
    path = folder / fields.label("file_path")
    # Blender-style files leave the suffix out.
    spelled = [path, *(path.parent / (path.name + suffix) for suffix in sorted(PICTURE_SUFFIXES))]
    found = next((candidate for candidate in spelled if os.path.exists(candidate)), None)
    if found is None:
        raise RigError(f"{fields.where}: {path} is missing; put it back or remove its entry from {CALIBRATION}")
    return _Entry(fields, found, fields.number("time", 0.0))


def _group_by_camera(entries: list[_Entry]) -> list[list[_Entry]]:
    """Entries of one camera together: single pictures in one folder with one pose are its frames."""
    groups: dict[tuple[Path, bytes], list[_Entry]] = {}
    for entry in entries:
        is_picture = entry.path.is_file() and entry.path.suffix.lower() in PICTURE_SUFFIXES
        pose = entry.fields.matrix("transform_matrix").tobytes()
        groups.setdefault((entry.path.parent if is_picture else entry.path, pose), []).append(entry)
    return [sorted(group, key=lambda entry: (entry.time, natural_key(entry.path.name))) for group in groups.values()]


def _camera_names(groups: list[list[_Entry]]) -> list[str]:
    """The file's name, or the folder's where file names repeat from camera to camera or count its frames."""
    stems = [group[0].path.stem if group[0].path.is_file() else group[0].path.name for group in groups]
    if all(len(group) == 1 for group in groups) and max(Counter(stems).values()) == 1:
        return stems
    folders = [group[0].path.parent for group in groups]
    return [folder.parent.name if folder.name in GENERIC_FOLDERS else folder.name for folder in folders]


def _source(group: list[_Entry]) -> FrameSource:
    first = group[0].path
    if len(group) == 1:
        return open_source(first)
    return open_pictures(first.parent, [entry.path for entry in group])


def _camera(name: str, fields: Fields, source: FrameSource) -> Camera:
    width = fields.integer("w") if "w" in fields else source.width
    height = fields.integer("h") if "h" in fields else source.height
    if "fl_x" in fields or "camera_angle_x" not in fields:
        fx = fields.number("fl_x")
    else:
        fx = _focal(fields, "camera_angle_x", width)
    if "fl_y" in fields or "camera_angle_y" not in fields:
        fy = fields.number("fl_y", fx)
    else:
        fy = _focal(fields, "camera_angle_y", height)
    model, distortion = _distortion(fields)
    opengl = rigid_pose(fields.matrix("transform_matrix"), f"{fields.where} ({name})")
    camera_to_world = opengl @ np.diag([1.0, -1.0, -1.0, 1.0])
    principal = (fields.number("cx", width / 2), fields.number("cy", height / 2))
    world_to_camera = invert_pose(camera_to_world)
    return calibrated_camera(
        name, (width, height), (fx, fy, *principal), world_to_camera, model, distortion, fields.where
    )


def _focal(fields: Fields, key: str, side: int) -> float:
    angle = fields.number(key)
    if not 0 < angle < math.pi:
        raise fields.wrong(key, f"is {angle:g}, not a field of view in radians")
    return side / (2 * math.tan(angle / 2))


def _distortion(fields: Fields) -> tuple[DistortionModel, tuple[float, ...]]:
    is_fisheye = fields.values.get("is_fisheye") is True
    model = fields.label("camera_model", "OPENCV_FISHEYE" if is_fisheye else "OPENCV")
    k1, k2, k3, k4, p1, p2 = (fields.number(key, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model == "OPENCV_FISHEYE":
        return "fisheye", (k1, k2, k3, k4)
    if model in _PINHOLE:
        return "none", ()
    if model not in _OPENCV:
        raise fields.wrong("camera_model", f"is {model!r}, which is not supported; undistort the pictures first")
    if k4:
        raise fields.wrong("k4", "is a fourth radial coefficient, which OpenCV's lens model does not have")
    return "opencv", (k1, k2, p1, p2, k3)
