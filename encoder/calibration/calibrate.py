"""Finds lenses and places of a rig's cameras from their videos, and writes them as a rig."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import RigError
from decogs.formats.outputs import staged_files
from decogs.formats.up_direction import AXES, turn_between, up_of

from .board_rig import place_by_board
from .boards import Board, BoardFinder, board_views
from .features import F64, features_of, matched, sift_extractor
from .footage import Footage, instants_of, open_footage, pictures_at
from .held_out import split
from .lenses import lens_from_board
from .structure import Mapped, Matched, map_cameras, require_pycolmap

MIN_CAMERAS = 3
_BOARD_INSTANTS, _INSTANTS = 60, 8
_MIN_EXPLAINED = 0.3
"""Share of matches held out that cameras have to explain. Right ones explain .36 of `panoptic_basketball` and .9 of
`workbench`; on `stage`, with its patterned wallpaper, the best that is found explains .25, and is wrong."""

OnStep = Callable[[int, int], None]


@dataclass(frozen=True)
class Placed:
    """A camera with its RMS reprojection error in pixels, and the source of its frames."""

    camera: Camera
    error: float
    footage: Footage


@dataclass(frozen=True)
class Calibration:
    """Placed cameras, what would help those that are not, by name, the way they were placed, and the world's unit."""

    placed: tuple[Placed, ...]
    not_connected: Mapping[str, str]
    way: str
    length_unit: str


def calibrate(
    videos: Path,
    *,
    board: Board | None = None,
    frames: int | None = None,
    seed: int = 0,
    shared_intrinsics: bool = False,
    on_step: OnStep = lambda done, total: None,
) -> Calibration:
    """Places the cameras whose videos are in a folder.

    ``frames``: instants of the take that are looked at. With a board the unit is the metre; else the mean distance of
    two cameras is 1. Up is -Y. Raises RigError where fewer than three cameras can be placed, with what would help.
    """
    footage = open_footage(videos)
    if len(footage) < MIN_CAMERAS:
        names = ", ".join(camera.name for camera in footage)
        raise RigError(f"{videos}: holds {len(footage)} cameras ({names}), and a rig needs {MIN_CAMERAS}; add videos")
    if board is not None:
        found = _by_board(footage, board, frames or _BOARD_INSTANTS, on_step)
    else:
        found = _by_motion(footage, frames or _INSTANTS, seed, shared_intrinsics, on_step)
    if len(found.placed) < MIN_CAMERAS:
        reasons = "; ".join(f"{name}: {help_}" for name, help_ in found.not_connected.items())
        raise RigError(f"{videos}: only {len(found.placed)} of {len(footage)} cameras can be placed. {reasons}")
    return _upright(found)


def _by_board(footage: tuple[Footage, ...], board: Board, count: int, on_step: OnStep) -> Calibration:
    find, corners, instants = BoardFinder(board), board.corners(), instants_of(footage, count)
    views, lenses = {}, {}
    for number, camera in enumerate(footage):
        views[number] = board_views(pictures_at(camera, instants), find)
        lens = lens_from_board(list(views[number].values()), corners, camera.size)
        if lens is not None:
            lenses[number] = lens
        on_step(number + 1, len(footage))
    rig = place_by_board(lenses, views, corners)
    placed = []
    for number in sorted(rig.poses):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rig.poses[number][0])[0], rig.poses[number][1]
        found = lenses[number].camera(footage[number].name, footage[number].size, pose)
        placed.append(Placed(found, rig.errors[number], footage[number]))
    reasons = {}
    for number, camera in enumerate(footage):
        if number in rig.poses:
            continue
        seen = len(views[number])
        if number in rig.inconsistent and any(view.mirrored for view in views[number].values()):
            reasons[camera.name] = "sees the board mirrored, where other cameras do not have it; is its video mirrored?"
        elif number in rig.inconsistent:
            reasons[camera.name] = (
                "sees the board elsewhere than other cameras at the same frame; synchronise the videos"
            )
        elif number not in lenses:
            reasons[camera.name] = f"sees the board in {seen} of {len(instants)} frames looked at; show it the board"
        else:
            reasons[camera.name] = "never sees the board together with a placed camera; hold it where both see it"
    return Calibration(tuple(placed), reasons, "board", "metre")


def _by_motion(footage: tuple[Footage, ...], count: int, seed: int, shared: bool, on_step: OnStep) -> Calibration:
    require_pycolmap()
    instants, extractor = instants_of(footage, count), sift_extractor()
    total = len(footage) + 4
    features = []
    for number, camera in enumerate(footage):
        features.append(features_of(list(pictures_at(camera, instants)), extractor))
        on_step(number + 1, total)
    pairs = [(a, b) for a in range(len(footage)) for b in range(a + 1, len(footage))]
    matches = split(features, {(a, b): matched(features[a], features[b]) for a, b in pairs})
    names, sizes = [camera.name for camera in footage], [camera.size for camera in footage]
    ways = iter(range(len(footage) + 1, total + 1))
    mapped = map_cameras(Matched(names, sizes, features, matches, {}, shared), seed, lambda: on_step(next(ways), total))
    board = "show all cameras a board (--board), or put a camera in between"
    if mapped is None:
        return Calibration((), dict.fromkeys(names, f"shares too little with other cameras; {board}"), "", "")
    if mapped.score.explained < _MIN_EXPLAINED:
        why = f"its matches contradict one another, as with repeated patterns; {board}"
        return Calibration((), dict.fromkeys(names, why), "", "")
    placed = tuple(
        Placed(camera, _reprojection_error(mapped, number), footage[number])
        for number, camera in sorted(mapped.cameras.items())
    )
    left = [name for number, name in enumerate(names) if number not in mapped.cameras]
    found = Calibration(placed, dict.fromkeys(left, f"shares too little with placed cameras; {board}"), mapped.way, "")
    return _scaled(found)


def _reprojection_error(mapped: Mapped, number: int) -> float:
    """Root mean square, px, of the points that the camera sees."""
    image = mapped.model.images[number + 1]
    squares = [
        float(((image.project_point(mapped.model.points3D[point.point3D_id].xyz) - point.xy) ** 2).sum())
        for point in image.points2D
        if point.has_point3D()
    ]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _scaled(found: Calibration) -> Calibration:
    """With 1 as the mean distance of two cameras."""
    centres = np.array([camera_centre(placed.camera) for placed in found.placed])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)[np.triu_indices(len(centres), 1)]
    return _moved(found, np.eye(3), 1 / float(distances.mean())) if distances.size else found


def _upright(found: Calibration) -> Calibration:
    """Turned so that up is -Y, as in COLMAP's worlds."""
    up = up_of([placed.camera for placed in found.placed])
    return _moved(found, turn_between(up, AXES["-Y"]), 1.0)


def _moved(found: Calibration, rotation: F64, scale: float) -> Calibration:
    """In a world that is turned, scaled, and has the middle of the cameras as its origin."""
    middle = np.mean([camera_centre(placed.camera) for placed in found.placed], axis=0)

    def moved(camera: Camera) -> Camera:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] = scale * (pose[:3, 3] + pose[:3, :3] @ middle)
        pose[:3, :3] = pose[:3, :3] @ rotation.T
        return replace(camera, world_to_camera=pose)

    return replace(found, placed=tuple(replace(one, camera=moved(one.camera)) for one in found.placed))


def write_rig(found: Calibration, folder: Path) -> None:
    """Writes rig.json, which names the videos by relative paths, and calibration.json.

    Raises RigError where the folder has a calibration that this did not write.
    """
    if (folder / "rig.json").exists() and not (folder / "calibration.json").exists():
        raise RigError(f"{folder / 'rig.json'}: another calibration is there; name another folder")
    with staged_files(folder) as staging:
        for name, document in (("rig.json", _rig(found, folder)), ("calibration.json", _document(found))):
            (staging / name).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _rig(found: Calibration, folder: Path) -> dict[str, Any]:
    cameras = [
        {
            "name": one.camera.name,
            "file": os.path.relpath(one.footage.source.path.resolve(), folder.resolve()),
            "width": one.camera.width,
            "height": one.camera.height,
            "fx": one.camera.fx,
            "fy": one.camera.fy,
            "cx": one.camera.cx - 0.5,
            "cy": one.camera.cy - 0.5,
            "distortion_model": one.camera.distortion_model,
            "distortion": list(one.camera.distortion),
            "world_to_camera": one.camera.world_to_camera.tolist(),
        }
        for one in found.placed
    ]
    unit = {"length_unit": found.length_unit} if found.length_unit else {}
    return {"pixel_convention": "(0,0)", **unit, "cameras": cameras}


def _document(found: Calibration) -> dict[str, Any]:
    cameras = [
        {
            "name": one.camera.name,
            "width": one.camera.width,
            "height": one.camera.height,
            "focal": [one.camera.fx, one.camera.fy],
            "centre": [one.camera.cx - 0.5, one.camera.cy - 0.5],
            "distortion_model": one.camera.distortion_model,
            "distortion": list(one.camera.distortion),
            "pose": {
                "rotation": one.camera.world_to_camera[:3, :3].tolist(),
                "translation": one.camera.world_to_camera[:3, 3].tolist(),
            },
            "reprojection_error": one.error,
        }
        for one in found.placed
    ]
    return {
        "pixel_convention": "(0,0)",
        "cameras": cameras,
        "not_connected": list(found.not_connected),
        "way": found.way,
    }
