"""Reads a free camera, or a path of them, from a JSON file ("pose.json").

One camera is an object::

    {
      "width": 640, "height": 360,            pixels
      "fx": 500, "fy": 500,                   focal lengths in pixels (fy may be left out: square pixels) ...
      "fov_y": 40,                            ... or the vertical field of view in degrees (square pixels)
      "cx": 320, "cy": 180,                   principal point in pixels; the picture's centre when left out
      "near": 0.1,                            nothing whose depth is below it is drawn; 0 when left out
      "world_to_camera": [[...], ...],        4x4 rows, rigid; or one of the next two
      "camera_to_world": [[...], ...],
      "position": [x, y, z], "look_at": [x, y, z], "up": [x, y, z]
    }

World units and axes are the stream's own (those of its rig). Camera axes are OpenCV's: x right, y down, z forward.
Pixels are measured from the picture's top left corner: the centre of the first pixel is (0.5, 0.5), and the centre of
a picture is (width / 2, height / 2). There is no lens distortion.

A camera path is a list of such objects, all of one size: entry t is the camera of frame t, whichever frames are
decoded. When every entry has a ``"frame"``, the path has a time of its own: entry k is picture k and shows that frame
of the stream, the nearest one to a fraction. Frames may repeat (bullet time), be skipped, and run backwards.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError

from .fields import Wrong, checked, cross, focal_length, number, numbers, of_entry, parsed_json, pose_of, rigid, side
from .path import CameraPath, check_pictures

FREE_CAMERA_NAME = "camera"

_LENS_FIELDS = frozenset({"width", "height", "fx", "fy", "fov_y", "cx", "cy", "near"})
_POSE_FIELDS = ({"world_to_camera"}, {"camera_to_world"}, {"position", "look_at", "up"})
_TIME = "frame"
_FIELDS = _LENS_FIELDS.union({_TIME}, *_POSE_FIELDS)


def read_free_cameras(path: str | os.PathLike[str]) -> CameraPath:
    """The cameras in a pose file: one for every frame of the scene alike, or a path, with times of its own or without.

    Raises UsageError, naming the file, the entry and the field, when anything is missing, unknown or impossible.
    """
    return pose_file_path(parsed_json(Path(path)), path)


def pose_file_path(data: Any, path: str | os.PathLike[str]) -> CameraPath:
    """The same from the file's JSON."""
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise UsageError(f"{path}: the camera path is empty; list one camera per frame")
    check_pictures(len(entries), f"{path}")
    listed = isinstance(data, list)

    def named(t: int) -> str:
        return f"{path}: camera {t}" if listed else f"{path}"

    cameras = [of_entry(_camera, entry, named(t)) for t, entry in enumerate(entries)]
    times = [of_entry(_time, entry, named(t)) for t, entry in enumerate(entries)]
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) > 1:
        raise UsageError(f"{path}: the cameras of a path must have one size, not {len(sizes)} different ones")
    given = tuple(time for time in times if time is not None)
    if given and len(given) < len(times):
        raise UsageError(f"{named(times.index(None))}: has no frame, and others have; give every entry one, or none")
    return CameraPath(tuple(cameras), given or None, source=f"{path}")


def _camera(entry: Any) -> Camera:
    if not isinstance(entry, dict):
        raise Wrong("a camera must be a JSON object with width, height, a focal length and a pose")
    unknown = sorted(set(entry) - _FIELDS)
    if unknown:
        raise Wrong(f"unknown field {unknown[0]!r}; known are {', '.join(sorted(_FIELDS))}")
    width, height = side(entry, "width"), side(entry, "height")
    fx, fy = _focal_lengths(entry, height)
    cx = number(entry, "cx") if "cx" in entry else width / 2
    cy = number(entry, "cy") if "cy" in entry else height / 2
    near = number(entry, "near") if "near" in entry else 0.0
    if near < 0:
        raise Wrong(f"near is {near:g}; it must be 0 or above")
    return checked(Camera(FREE_CAMERA_NAME, width, height, fx, fy, cx, cy, _world_to_camera(entry), near=near))


def _time(entry: dict[str, Any]) -> float | None:
    if _TIME not in entry:
        return None
    time = number(entry, _TIME)
    if time < 0:
        raise Wrong(f"frame is {time:g}; frames count from 0")
    return time


def _focal_lengths(entry: dict[str, Any], height: int) -> tuple[float, float]:
    if ("fov_y" in entry) == ("fx" in entry) or ("fov_y" in entry and "fy" in entry):
        raise Wrong("give either fx (and fy), in pixels, or fov_y, in degrees")
    if "fov_y" in entry:
        focal = focal_length(entry, "fov_y", height)
        return focal, focal
    fx = number(entry, "fx")
    fy = number(entry, "fy") if "fy" in entry else fx
    if not (fx > 0 and fy > 0):
        raise Wrong("fx and fy must be above 0")
    return fx, fy


def _world_to_camera(entry: dict[str, Any]) -> NDArray[np.float64]:
    given = [fields for fields in _POSE_FIELDS if fields & set(entry)]
    if len(given) != 1 or not given[0] <= set(entry):
        raise Wrong("give the pose in one way: world_to_camera, camera_to_world, or position with look_at and up")
    if "world_to_camera" in entry:
        return rigid(entry, "world_to_camera")
    if "camera_to_world" in entry:
        pose = rigid(entry, "camera_to_world")
        return pose_of(pose[:3, :3].T, pose[:3, 3])
    position, target, up = (numbers(entry, name, (3,)) for name in ("position", "look_at", "up"))
    return _looking(position, target, up)


def _looking(
    position: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The pose of a camera at ``position`` that sees ``target`` in its centre and ``up`` upwards."""
    forward = target - position
    right = cross(forward, up)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up) or not right.any():
        raise Wrong("look_at must differ from position, and up must not point along the line of sight")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return pose_of(np.stack([right, cross(forward, right), forward]), position)
