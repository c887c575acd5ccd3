"""Numbers of a camera in JSON: a field that is missing or of the wrong kind is named with its file and entry."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import MAX_SIDE, Camera
from decogs.formats.errors import UsageError

from ..limits import DEFAULT_MAX_MEMORY

LARGEST = 1e12
"""Of a camera's numbers: what is computed of them stays finite."""

MAX_FILE_BYTES, _EXPANSION = 64 << 20, 48
"""A file of JSON may take this fraction of the memory: an empty object is 3 bytes, and 72 as Python's. The cameras made
of the shortest entries take 8 bytes each."""

_NARROWEST = 1e-6
_RIGID_TOLERANCE = 1e-3
_Read = TypeVar("_Read")


class Wrong(Exception):
    """What is wrong with one camera; the reader adds the file and the entry."""


def of_entry(read: Callable[[Any], _Read], entry: Any, where: str) -> _Read:
    """What ``read`` makes of an entry; what is wrong with it becomes a UsageError that says ``where``."""
    try:
        return read(entry)
    except Wrong as wrong:
        raise UsageError(f"{where}: {wrong}") from None


def parsed_json(path: Path, max_memory: int = DEFAULT_MAX_MEMORY) -> Any:
    """A JSON file's content; raises UsageError for one that is none, names a field twice, or cannot be read.

    Also for one whose content might take more than ``max_memory`` bytes.
    """
    most = min(MAX_FILE_BYTES, max_memory // _EXPANSION)
    try:
        with path.open("rb") as file:
            data = file.read(most + 1)  # devices and pipes have no size
        if len(data) > most:
            more = "" if most == MAX_FILE_BYTES else ", or allow more memory (`max_memory`)"
            raise UsageError(f"{path}: has more than {most} bytes; give a shorter camera path{more}")
        return json.loads(data.decode("utf-8"), object_pairs_hook=_unique_fields)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); name a camera file (JSON)") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is not valid JSON ({str(error).splitlines()[0]})") from None


def _unique_fields(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs):
        twice, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"it names the field {twice[:40]!a} twice")
    return fields


def pose_of(rotation: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """World to camera, of a camera at ``position`` whose axes are the rows of ``rotation``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ position
    return pose


def cross(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The cross product of two vectors (3,); `np.cross` takes ten times as long for one, and paths have many."""
    (a, b, c), (x, y, z) = first.tolist(), second.tolist()
    return np.array([b * z - c * y, c * x - a * z, a * y - b * x])


def rigid(entry: dict[str, Any], name: str) -> NDArray[np.float64]:
    """A (4, 4) field whose rotation is one to within rounding; the nearest exact rotation takes its place."""
    matrix = numbers(entry, name, (4, 4))
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-5:
        raise Wrong(f"the last row of {name} must be 0 0 0 1 (row-major, translation in the last column)")
    left, stretch, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(stretch - 1).max() > _RIGID_TOLERANCE or matrix[0, :3] @ cross(matrix[1, :3], matrix[2, :3]) < 0:
        raise Wrong(f"{name} is not rigid: its rotation scales, shears or mirrors")
    matrix[:3, :3] = left @ right
    return matrix


def side(entry: dict[str, Any], name: str) -> int:
    """A field that is a picture's width or height."""
    value = number(entry, name)
    if value != int(value) or not 1 <= value <= MAX_SIDE:
        raise Wrong(f"{name} is {value:g}; it must be a whole number of pixels from 1 to {MAX_SIDE}")
    return int(value)


def focal_length(entry: dict[str, Any], name: str, height: int) -> float:
    """In pixels, of a field that is the vertical angle of view in degrees."""
    angle = number(entry, name)
    if not _NARROWEST <= angle < 180:
        raise Wrong(f"{name} is {angle:g} degrees; it must lie between {_NARROWEST:g} and 180")
    return height / 2 / math.tan(math.radians(angle) / 2)


def checked(camera: Camera) -> Camera:
    """The camera; raises Wrong where it was computed to be farther away, or narrower, than can be drawn."""
    values = (np.abs(camera.world_to_camera).max(), camera.fx, camera.fy, camera.cx, camera.cy, camera.near)
    if not (all(abs(value) <= LARGEST for value in values) and min(camera.fx, camera.fy) >= 1 / LARGEST):
        raise Wrong(f"its place or its focal length is not within {1 / LARGEST:g} to {LARGEST:g} units and pixels")
    return camera


def number(entry: dict[str, Any], name: str) -> float:
    """A field that is a finite number."""
    value = entry.get(name)
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST:
        return float(value)
    return float(numbers(entry, name, ()))  # which says what is wrong


def numbers(entry: dict[str, Any], name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A field as finite float64 of this shape."""
    if name not in entry:
        raise Wrong(f"{name} is missing")
    what = "a number" if not shape else f"{' by '.join(map(str, shape))} numbers"
    if not _only_numbers(entry[name]):
        raise Wrong(f"{name} must be {what}")
    try:
        array = np.array(entry[name], dtype=np.float64)
    except (ValueError, OverflowError):
        raise Wrong(f"{name} must be {what}") from None
    if array.shape != shape or not np.abs(array).max() <= LARGEST:
        raise Wrong(f"{name} must be {what}, finite and at most {LARGEST:g}")
    return array


def _only_numbers(value: Any) -> bool:
    """Numbers nested in lists no deeper than a matrix is."""
    rows = value if isinstance(value, list) else [value]
    items = [item for row in rows for item in (row if isinstance(row, list) else [row])]
    return all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items)
