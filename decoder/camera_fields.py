"""Numbers of a camera in JSON: a field that is missing or of the wrong kind is named with its file and entry."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import MAX_SIDE
from decogs.formats.errors import UsageError

MAX_FILE_BYTES = 64 << 20
_RIGID_TOLERANCE = 1e-3
_LARGEST = 1e12
_Read = TypeVar("_Read")


class Wrong(Exception):
    """What is wrong with one camera; the reader adds the file and the entry."""


def of_entry(read: Callable[[Any], _Read], entry: Any, where: str) -> _Read:
    """What ``read`` makes of an entry; what is wrong with it becomes a UsageError that says ``where``."""
    try:
        return read(entry)
    except Wrong as wrong:
        raise UsageError(f"{where}: {wrong}") from None


def parsed_json(path: Path) -> Any:
    """A JSON file's content; raises UsageError for one that is none, too large, or cannot be read."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)  # devices and pipes have no size
        if len(data) > MAX_FILE_BYTES:
            raise UsageError(f"{path}: is larger than {MAX_FILE_BYTES >> 20} MB; that is no camera file")
        return json.loads(data.decode("utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); name a camera file (JSON)") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is not valid JSON ({str(error).splitlines()[0]})") from None


def pose_of(rotation: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """World to camera, of a camera at ``position`` whose axes are the rows of ``rotation``."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ position
    return pose


def rigid(entry: dict[str, Any], name: str) -> NDArray[np.float64]:
    """A (4, 4) field whose rotation is one to within rounding; the nearest exact rotation takes its place."""
    matrix = numbers(entry, name, (4, 4))
    if not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise Wrong(f"the last row of {name} must be 0 0 0 1 (row-major, translation in the last column)")
    left, stretch, right = np.linalg.svd(matrix[:3, :3])
    if np.abs(stretch - 1).max() > _RIGID_TOLERANCE or np.linalg.det(matrix[:3, :3]) < 0:
        raise Wrong(f"{name} is not rigid: its rotation scales, shears or mirrors")
    matrix[:3, :3] = left @ right
    return matrix


def side(entry: dict[str, Any], name: str) -> int:
    """A field that is a picture's width or height."""
    value = number(entry, name)
    if value != int(value) or not 1 <= value <= MAX_SIDE:
        raise Wrong(f"{name} is {value:g}; it must be a whole number of pixels from 1 to {MAX_SIDE}")
    return int(value)


def number(entry: dict[str, Any], name: str) -> float:
    """A field that is a finite number."""
    return float(numbers(entry, name, ()))


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
    if array.shape != shape or not np.all(np.abs(array) <= _LARGEST):
        raise Wrong(f"{name} must be {what}, finite and at most {_LARGEST:g}")
    return array


def _only_numbers(value: Any) -> bool:
    """Numbers nested in lists no deeper than a matrix is."""
    rows = value if isinstance(value, list) else [value]
    items = [item for row in rows for item in (row if isinstance(row, list) else [row])]
    return all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in items)
