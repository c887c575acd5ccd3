"""Qualisys Track Manager: ``NAME.qca.txt``, XML despite its name, and a video for each video camera.

``intrinsic``: focal lengths and principal point in 1/64 pixel, the centre of the first pixel at 0 (``sensorMaxU`` is 64
times the width less one), counted on the sensor, of which ``fov_video`` is filmed; distortion as OpenCV has it, not
in 64ths: k1 is what a chessboard gives for the same lens. ``transform``: x, y, z are the camera's place in millimetres,
the rows of r the world's axes in the camera with y up and z backwards. Marker cameras, without "video" or "none" as
their model, have no frames and are passed over. Source: perfanalytics/pose2sim, Pose2Sim/calibration.py (read_qca).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..cameras import Camera
from ..errors import RigError
from .calibration import invert_pose, opencv_camera, rigid_pose
from .fields import parse_xml, read_calibration_file
from .named_frames import frames_of_cameras, rig_folder_of, usual_folders
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "qualisys"
CALIBRATIONS = ("*.qca.txt", "calibration/*.qca.txt")
_SUBPIXELS = 64
_MILLIMETRE = 1e-3


def read_qualisys(calibration: Path) -> Rig:
    """The rig in the folder of a .qca.txt file. Raises RigError."""
    cameras = {camera.name: camera for camera in (_camera(element) for element in _video_cameras(calibration))}
    folder = rig_folder_of(calibration)
    frames = frames_of_cameras(calibration, usual_folders(folder), {name: (name,) for name in cameras})
    pairs = [(cameras[name], open_source(path)) for name, path in frames.of.items()]
    rig = assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=True, length_unit="metre")
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


@dataclass(frozen=True)
class _Element:
    """An XML element whose attributes are numbers; ``where`` begins every message."""

    element: ElementTree.Element
    where: str

    def inside(self, tag: str) -> _Element:
        child = self.element.find(tag)
        if child is None:
            raise RigError(f"{self.where}: <{tag}> is missing; export the calibration again")
        return _Element(child, f"{self.where}, <{tag}>")

    def number(self, name: str) -> float:
        try:
            value = float(self.element.get(name, ""))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise RigError(f"{self.where}: {name!r} is missing or no finite number; export the calibration again")
        return value


def _video_cameras(path: Path) -> list[_Element]:
    root = parse_xml(path, read_calibration_file(path))
    cameras = [
        _Element(element, f"{path}, camera {element.get('serial', '')!r}")
        for element in root.findall("cameras/camera")
        if any(kind in element.get("model", "none").lower() for kind in ("video", "none"))
    ]
    if not cameras:
        raise RigError(f"{path}: lists no video camera; export the calibration of the video cameras")
    if len({camera.element.get("serial") for camera in cameras}) < len(cameras):
        raise RigError(f"{path}: two cameras have one serial; export the calibration again")
    return cameras


def _camera(camera: _Element) -> Camera:
    filmed, intrinsic, transform = (camera.inside(tag) for tag in ("fov_video", "intrinsic", "transform"))
    left, top, right, bottom = (filmed.number(side) for side in ("left", "top", "right", "bottom"))
    fx, fy, cx, cy = (
        intrinsic.number(name) / _SUBPIXELS for name in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
    )
    matrix = [fx, intrinsic.number("skew") / _SUBPIXELS, cx - left, 0, fy, cy - top, 0, 0, 1]
    names = ("radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2")
    lens = [intrinsic.number(name) for name in (*names, "radialDistortion3")]
    rows = [[transform.number(f"r{row}{column}") for column in (1, 2, 3)] for row in (1, 2, 3)]
    centre = [transform.number(axis) * _MILLIMETRE for axis in "xyz"]
    axes = np.array(rows) * [[1.0], [-1.0], [-1.0]]
    pose = invert_pose(rigid_pose(np.column_stack([axes.T, centre]), transform.where))
    size = (round(right - left + 1), round(bottom - top + 1))
    return opencv_camera(camera.element.get("serial", ""), size, matrix, lens, pose, camera.where)
