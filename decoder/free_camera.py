"""Reads a free camera, or a path of them, from a JSON file ("pose.json").

One camera is an object::

    {
      "width": 640, "height": 360,            pixels
      "fx": 500, "fy": 500,                   focal lengths in pixels (fy may be left out: square pixels) ...
      "fov_y": 40,                            ... or the vertical field of view in degrees (square pixels)
      "cx": 320, "cy": 180,                   principal point in pixels; the picture's centre when left out
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

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import MAX_SIDE, Camera
from decogs.formats.errors import UsageError

from .camera_path import CameraPath

MAX_FILE_BYTES = 64 << 20
FREE_CAMERA_NAME = "camera"

_LENS_FIELDS = frozenset({"width", "height", "fx", "fy", "fov_y", "cx", "cy"})
_POSE_FIELDS = ({"world_to_camera"}, {"camera_to_world"}, {"position", "look_at", "up"})
_TIME = "frame"
_FIELDS = _LENS_FIELDS.union({_TIME}, *_POSE_FIELDS)
_RIGID_TOLERANCE = 1e-3
_LARGEST = 1e12
_Read = TypeVar("_Read")


class _Wrong(Exception):
    """What is wrong with one camera; the reader adds the file and the entry."""


def read_free_cameras(path: str | os.PathLike[str]) -> CameraPath:
    """The cameras in a pose file: one for every frame of the scene alike, or a path, with times of its own or without.

    Raises UsageError, naming the file, the entry and the field, when anything is missing, unknown or impossible.
    """
    data = _parsed(Path(path))
    entries = data if isinstance(data, list) else [data]
    if not entries:
        raise UsageError(f"{path}: the camera path is empty; list one camera per frame")
    listed = isinstance(data, list)
    places = [f"{path}: camera {t}" if listed else f"{path}" for t in range(len(entries))]
    cameras = [_of_entry(_camera, entry, where) for entry, where in zip(entries, places, strict=True)]
    times = [_of_entry(_time, entry, where) for entry, where in zip(entries, places, strict=True)]
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) > 1:
        raise UsageError(f"{path}: the cameras of a path must have one size, not {len(sizes)} different ones")
    given = tuple(time for time in times if time is not None)
    if given and len(given) < len(times):
        raise UsageError(f"{places[times.index(None)]}: has no frame, and others have; give every entry one, or none")
    return CameraPath(tuple(cameras), given or None, source=f"{path}")


def _of_entry(read: Callable[[Any], _Read], entry: Any, where: str) -> _Read:
    try:
        return read(entry)
    except _Wrong as wrong:
        raise UsageError(f"{where}: {wrong}") from None


def _parsed(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)  # what a device or a pipe holds, its size does not tell
        if len(data) > MAX_FILE_BYTES:
            raise UsageError(f"{path}: is larger than {MAX_FILE_BYTES >> 20} MB; that is no camera file")
        return json.loads(data.decode("utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); name a camera file (JSON)") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is not valid JSON ({str(error).splitlines()[0]})") from None


def _camera(entry: Any) -> Camera:
    if not isinstance(entry, dict):
        raise _Wrong("a camera must be a JSON object with width, height, a focal length and a pose")
    unknown = sorted(set(entry) - _FIELDS)
    if unknown:
        raise _Wrong(f"unknown field {unknown[0]!r}; known are {', '.join(sorted(_FIELDS))}")
    width, height = _side(entry, "width"), _side(entry, "height")
    fx, fy = _focal_lengths(entry, height)
    cx = _number(entry, "cx") if "cx" in entry else width / 2
    cy = _number(entry, "cy") if "cy" in entry else height / 2
    return Camera(FREE_CAMERA_NAME, width, height, fx, fy, cx, cy, _world_to_camera(entry))


def _time(entry: dict[str, Any]) -> float | None:
    if _TIME not in entry:
        return None
    time = _number(entry, _TIME)
    if time < 0:
        raise _Wrong(f"frame is {time:g}; frames count from 0")
    return time


def _focal_lengths(entry: dict[str, Any], height: int) -> tuple[float, float]:
    if ("fov_y" in entry) == ("fx" in entry) or ("fov_y" in entry and "fy" in entry):
        raise _Wrong("give either fx (and fy), in pixels, or fov_y, in degrees")
    if "fov_y" in entry:
        angle = _number(entry, "fov_y")
        if not 0 < angle < 180:
            raise _Wrong(f"fov_y is {angle:g} degrees; it must lie between 0 and 180")
        focal = height / 2 / math.tan(math.radians(angle) / 2)
        return focal, focal
    fx = _number(entry, "fx")
    fy = _number(entry, "fy") if "fy" in entry else fx
    if not (fx > 0 and fy > 0):
        raise _Wrong("fx and fy must be above 0")
    return fx, fy


def _world_to_camera(entry: dict[str, Any]) -> NDArray[np.float64]:
    given = [fields for fields in _POSE_FIELDS if fields & set(entry)]
    if len(given) != 1 or not given[0] <= set(entry):
        raise _Wrong("give the pose in one way: world_to_camera, camera_to_world, or position with look_at and up")
    if "world_to_camera" in entry:
        return _rigid(entry, "world_to_camera")
    if "camera_to_world" in entry:
        pose = _rigid(entry, "camera_to_world")
        return _pose(pose[:3, :3].T, pose[:3, 3])
    position, target, up = (_numbers(entry, name, (3,)) for name in ("position", "look_at", "up"))
    return _looking(position, target, up)


def _looking(
    position: NDArray[np.float64], target: NDArray[np.float64], up: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The pose of a camera at ``position`` that sees ``target`` in its centre and ``up`` upwards."""
    forward = target - position
    right = np.cross(forward, up)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(up) or not right.any():
        raise _Wrong("look_at must differ from position, and up must not point along the line of sight")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    return _pose(np.stack([right, np.cross(forward, right), forward]), position)


def _pose(rotation: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """World to camera, of a camera at ``position`` whose axes are the rows of ``rotation``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ position
    return pose


def _rigid(entry: dict[str, Any], name: str) -> NDArray[np.float64]:
    """A (4, 4) field whose rotation is one to within rounding; the nearest exact rotation takes its place."""
    matrix = _numbers(entry, name, (4, 4))
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise _Wrong(f"the last row of {name} must be 0 0 0 1 (row-major, translation in the last column)")
    left, stretch, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(stretch - 1).max() > _RIGID_TOLERANCE or np.linalg.det(matrix[:3, :3]) < 0:
        raise _Wrong(f"{name} is not rigid: its rotation scales, shears or mirrors")
    matrix[:3, :3] = left @ right
    return matrix


def _side(entry: dict[str, Any], name: str) -> int:
    value = _number(entry, name)
    if value != int(value) or not 1 <= value <= MAX_SIDE:
        raise _Wrong(f"{name} is {value:g}; it must be a whole number of pixels from 1 to {MAX_SIDE}")
    return int(value)


def _number(entry: dict[str, Any], name: str) -> float:
    return float(_numbers(entry, name, ()))


def _numbers(entry: dict[str, Any], name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A field as finite float64 of this shape."""
    if name not in entry:
        raise _Wrong(f"{name} is missing")
    what = "a number" if not shape else f"{' by '.join(map(str, shape))} numbers"
    if not _only_numbers(entry[name]):
        raise _Wrong(f"{name} must be {what}")
    try:
        array = np.array(entry[name], dtype=np.float64)
    except (ValueError, OverflowError):
        raise _Wrong(f"{name} must be {what}") from None
    if array.shape != shape or not np.all(np.abs(array) <= _LARGEST):
        raise _Wrong(f"{name} must be {what}, finite and at most {_LARGEST:g}")
    return array


def _only_numbers(value: Any) -> bool:
    """Numbers nested in lists no deeper than a matrix is."""
    rows = value if isinstance(value, list) else [value]
    items = [item for row in rows for item in (row if isinstance(row, list) else [row])]
    return all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items)
