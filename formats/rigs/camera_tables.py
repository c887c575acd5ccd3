"""Calibrations in TOML by aniposelib, Pose2Sim and caliscope: a table for each camera.

aniposelib and Pose2Sim have ``[cam_0]`` or ``[int_cam01_img]`` at the top, with ``name``, ``size``, ``matrix``,
``distortions``, ``rotation`` (Rodrigues), ``translation`` and ``fisheye``; caliscope's own file has the same inside
``[cameras.0]``, without a name. World-to-camera in OpenCV axes; the centre of the first pixel is at (0, 0), as OpenCV
calibrates. The file may lie in the rig's folder, or in ``calibration/`` there, as Pose2Sim has it.
Source: lambdaloop/aniposelib, aniposelib/cameras.py; mprib/caliscope, cameras/camera_array.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..cameras import Camera
from ..errors import RigError
from .calibration import opencv_camera, vector_pose
from .fields import Fields, read_toml
from .named_frames import frames_of_cameras, rig_folder_of, usual_folders
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "toml"
CALIBRATIONS = ("*[Cc]alib*.toml", "camera_array*.toml", "calibration/*[Cc]alib*.toml")
_COEFFICIENTS = ((4,), (5,), (8,), (12,), (14,), (0,))


def read_camera_tables(calibration: Path) -> Rig:
    """The rig in the folder of a TOML file with cameras. Raises RigError."""
    folder = rig_folder_of(calibration)
    tables = _tables(read_toml(calibration))
    if not tables:
        raise RigError(f"{calibration}: no table with 'matrix' and 'rotation'; calibrate the cameras and their places")
    spellings = {name: (name, key, f"cam_{key}", f"port_{key}") for name, (key, _) in tables.items()}
    frames = frames_of_cameras(calibration, usual_folders(folder), spellings)
    pairs = [(_camera(name, tables[name][1]), open_source(path)) for name, path in frames.of.items()]
    rig = assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=True)
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


def _tables(file: Fields) -> dict[str, tuple[str, Fields]]:
    """The cameras' tables and their keys by name; those without a pose are cameras that were not placed."""
    inside = file.values.get("cameras")
    values, before = (inside, "cameras.") if isinstance(inside, dict) else (file.values, "")
    tables: dict[str, tuple[str, Fields]] = {}
    for key, value in values.items():
        fields = Fields(value, f"{file.where}, [{before}{key}]") if isinstance(value, dict) else Fields({}, "")
        if "matrix" in fields and "rotation" in fields:
            name = fields.label("name", f"cam_{key}" if before else key)
            if name in tables:
                raise fields.wrong("name", f"is {name!r}, as that of another camera")
            tables[name] = key, fields
    return tables


def _camera(name: str, fields: Fields) -> Camera:
    width, height = (int(side) for side in fields.array("size", (2,)))
    pose = vector_pose(fields.array("rotation", (3,), (9,)), fields.array("translation", (3,)), fields.where)
    lens = fields.array("distortions", *_COEFFICIENTS) if "distortions" in fields else ()
    is_fisheye = fields.values.get("fisheye") is True
    matrix = fields.array("matrix", (3, 3))
    return opencv_camera(name, (width, height), matrix, lens, pose, fields.where, is_fisheye=is_fisheye)
