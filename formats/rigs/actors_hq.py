"""ActorsHQ: ``calibration.csv`` and ``rgbs/Cam001/Cam001_rgb000000.jpg`` ...

A line for each camera: name, w, h, rotation (Rodrigues) and translation, camera-to-world in OpenCV axes and metres;
fx and px as shares of the width, fy and py of the height, so that pixel centres are at .5. Columns k1, k2, k3, where
they are, are OpenCV's. Cameras without pictures are left out.
Source: synthesiaresearch/humanrf, actorshq/dataset/camera_data.py and volumetric_dataset.py.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from ..cameras import Camera
from ..errors import RigError
from .calibration import calibrated_camera, invert_pose, vector_pose
from .fields import read_calibration_file
from .named_frames import frames_of_cameras
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "actorshq"
CALIBRATION = "calibration.csv"
_COLUMNS = ("w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
_LENS = ("k1", "k2", "k3")


def read_actors_hq(calibration: Path) -> Rig:
    """The rig in the folder of a calibration.csv. Raises RigError."""
    folder = calibration.parent
    rows = _rows(calibration)
    frames = frames_of_cameras(calibration, [folder / "rgbs"], {name: (name,) for name in rows}, may_lack=True)
    pairs = [
        (_camera(name, rows[name], f"{calibration}, {name}"), open_source(path)) for name, path in frames.of.items()
    ]
    rig = assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=True, length_unit="metre")
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


def _rows(path: Path) -> dict[str, dict[str, float]]:
    """The numbers of each camera by column."""
    text = read_calibration_file(path).decode("utf-8-sig", errors="replace")
    try:
        table = list(csv.DictReader(text.splitlines()))
    except csv.Error as error:
        raise RigError(f"{path}: malformed CSV ({error}); correct the file") from None
    lacking = [column for column in ("name", *_COLUMNS) if not table or column not in table[0]]
    if lacking:
        raise RigError(f"{path}: no camera with a column {lacking[0]!r}; correct the file")
    rows: dict[str, dict[str, float]] = {}
    for number, line in enumerate(table, start=2):
        name = line["name"] or ""
        if name in rows:
            raise RigError(f"{path}: two cameras are called {name!r}; give every camera its own name")
        present = [column for column in (*_COLUMNS, *_LENS) if column in line]
        rows[name] = {column: _number(line[column], f"{path}, line {number}, {column}") for column in present}
    return rows


def _number(text: str | None, where: str) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RigError(f"{where}: {text or ''!r} is no finite number; correct the file")
    return value


def _camera(name: str, row: Mapping[str, float], where: str) -> Camera:
    width, height = row["w"], row["h"]
    turn, centre = ([row[kind + axis] for axis in "xyz"] for kind in "rt")
    intrinsics = (width * row["fx"], height * row["fy"], width * row["px"], height * row["py"])
    k1, k2, k3 = (row.get(column, 0.0) for column in _LENS)
    pose = invert_pose(vector_pose(turn, centre, where))
    size = (round(width), round(height))
    return calibrated_camera(name, size, intrinsics, pose, "opencv", (k1, k2, 0.0, 0.0, k3), where)
