"""CMU Panoptic Studio: ``calibration_SEQUENCE.json`` and ``hdVideos/hd_00_00.mp4`` or ``hdImgs/00_00/``.

Of the cameras those of type "hd" that have frames are read; VGA and Kinect cameras have other rates. ``K``, ``R``,
``t`` and ``distCoef`` are OpenCV's, world-to-camera, the centre of the first pixel at (0, 0), as for its
``projectPoints``. World units are centimetres.
Source: CMU-Perceptual-Computing-Lab/panoptic-toolbox, python/panutils.py.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..cameras import Camera
from ..errors import RigError
from .calibration import opencv_camera, vector_pose
from .fields import Fields, read_json
from .named_frames import frames_of_cameras
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "panoptic"
CALIBRATIONS = ("calibration_*.json",)


def read_panoptic(calibration: Path) -> Rig:
    """The rig of the HD cameras in the folder of a calibration_SEQUENCE.json. Raises RigError."""
    folder = calibration.parent
    listed = read_json(calibration).records("cameras")
    records = {record.label("name"): record for record in listed if record.label("type", "hd") == "hd"}
    if not records:
        raise RigError(f"{calibration}: lists no camera of type 'hd'; VGA and Kinect cameras are not read")
    folders = [folder / "hdVideos", folder / "hdImgs", folder]
    frames = frames_of_cameras(calibration, folders, {name: (f"hd_{name}", name) for name in records}, may_lack=True)
    pairs = [(_camera(name, records[name]), open_source(path)) for name, path in frames.of.items()]
    rig = assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=True, length_unit="centimetre")
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


def _camera(name: str, record: Fields) -> Camera:
    where = f"{record.where} ({name})"
    width, height = (int(side) for side in record.array("resolution", (2,)))
    pose = vector_pose(record.array("R", (3, 3)), record.array("t", (3,)), where)
    return opencv_camera(
        name, (width, height), record.array("K", (3, 3)), record.array("distCoef", (5,), (4,)), pose, where
    )
