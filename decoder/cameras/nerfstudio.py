"""Reads the ``camera_path.json`` that nerfstudio's viewer and its Blender add-on write.

``render_width`` and ``render_height`` in pixels; ``camera_path``: a list of entries with ``camera_to_world`` (16
numbers or 4x4, row-major, OpenGL axes: x right, y up, z backwards) and ``fov``, the vertical angle in degrees. ``fps``
counts the pictures. ``render_time``, 0 to 1 from the stream's first frame to its last, is the time of a picture where
every entry has one; else the stream plays at its own rate. Source: nerfstudio, ``get_path_from_json`` of
cameras/camera_paths.py.

nerfstudio turns, centres and scales a scene before it trains. Where ``dataparser_transforms.json`` lies beside the path
(nerfstudio writes it beside its config.yml), that is undone: p_path = scale (transform (p_world, 1)).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError

from .fields import LARGEST, Wrong, checked, focal_length, number, numbers, of_entry, parsed_json, pose_of, rigid, side
from .path import FPS, CameraPath, ToFilm, check_pictures

TRANSFORMS = "dataparser_transforms.json"
_NAME = "camera"
_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def is_nerfstudio_path(data: Any) -> bool:
    """Whether the content of a JSON file is such a path."""
    return isinstance(data, dict) and "camera_path" in data


def nerfstudio_path(data: dict[str, Any], path: Path, film: ToFilm) -> CameraPath:
    """The path in the content of ``path``; raises UsageError for what is missing or wrong."""
    kind = data.get("camera_type", "perspective")
    if kind != "perspective":
        raise UsageError(f"{path}: its camera_type is {str(kind)[:40]!r}; only perspective paths are rendered")
    entries = data["camera_path"]
    if not isinstance(entries, list) or not entries:
        raise UsageError(f"{path}: camera_path must be a list of cameras that is not empty")
    check_pictures(len(entries), f"{path}")
    size = of_entry(lambda fields: (side(fields, "render_width"), side(fields, "render_height")), data, f"{path}")
    to_world = _to_world(path.parent / TRANSFORMS)
    entry_names = [f"{path}: camera {k}" for k in range(len(entries))]
    cameras = tuple(
        of_entry(lambda entry: _camera(entry, size, to_world), entry, where)
        for entry, where in zip(entries, entry_names, strict=True)
    )
    fps = of_entry(_rate, data, f"{path}")
    if all("render_time" in entry for entry in entries):
        last = (film.frame_count or 1) - 1
        times = [of_entry(_render_time, entry, where) * last for entry, where in zip(entries, entry_names, strict=True)]
    else:
        times = [
            film.frame_at(k / fps) if fps else float(min(k, (film.frame_count or k + 1) - 1))
            for k in range(len(entries))
        ]
    return CameraPath(cameras, tuple(times), fps, f"{path}")


def _camera(entry: Any, size: tuple[int, int], to_world: _Similarity) -> Camera:
    if not isinstance(entry, dict):
        raise Wrong("a camera must be a JSON object")
    focal = focal_length(entry, "fov", size[1])
    pose = rigid({"camera_to_world": _four_by_four(entry)}, "camera_to_world") @ _OPENGL
    rotation, position = to_world.undone(pose[:3, :3], pose[:3, 3])
    return checked(Camera(_NAME, *size, focal, focal, size[0] / 2, size[1] / 2, pose_of(rotation.T, position)))


def _four_by_four(entry: dict[str, Any]) -> Any:
    flat = entry.get("camera_to_world")
    if isinstance(flat, list) and len(flat) == 16:
        return [flat[row : row + 4] for row in range(0, 16, 4)]
    return flat


def _rate(data: dict[str, Any]) -> float | None:
    if data.get("fps") is None:
        return None
    fps = number(data, "fps")
    if not FPS[0] <= fps <= FPS[1]:
        raise Wrong(f"fps is {fps:g}; it must lie between {FPS[0]:g} and {FPS[1]:g}")
    return fps


def _render_time(entry: dict[str, Any]) -> float:
    time = number(entry, "render_time")
    if not 0 <= time <= 1:
        raise Wrong(f"render_time is {time:g}; it runs from 0 to 1")
    return time


class _Similarity:
    """p_path = scale (rotation p_world + shift)."""

    def __init__(self, rotation: NDArray[np.float64], shift: NDArray[np.float64], scale: float) -> None:
        self._rotation, self._shift, self._scale = rotation, shift, scale

    def undone(
        self, axes: NDArray[np.float64], position: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Camera-to-world rotation and position in the world."""
        return self._rotation.T @ axes, self._rotation.T @ (position / self._scale - self._shift)


def _to_world(path: Path) -> _Similarity:
    if not path.exists():
        return _Similarity(np.eye(3), np.zeros(3), 1.0)
    if not path.is_file():  # a pipe would keep the reader waiting
        raise UsageError(f"{path}: is no file, and lies beside the camera path; take it away")

    def read(data: Any) -> _Similarity:
        if not isinstance(data, dict):
            raise Wrong("must be a JSON object with transform and scale")
        transform, scale = numbers(data, "transform", (3, 4)), number(data, "scale")
        if scale < 1 / LARGEST:
            raise Wrong(f"scale is {scale:g}; it must be at least {1 / LARGEST:g}")
        whole = rigid({"transform": [*transform.tolist(), [0, 0, 0, 1]]}, "transform")
        return _Similarity(whole[:3, :3], whole[:3, 3], scale)

    return of_entry(read, parsed_json(path), f"{path}")
