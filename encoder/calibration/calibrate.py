"""Finds lenses and places of a rig's cameras from their videos, and writes them as a rig."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import RigError
from decogs.formats.outputs import staged_files
from decogs.formats.up_direction import AXES, turn_between, up_of

from .board_rig import BoardRig, place_by_board
from .boards import Board, BoardFinder, BoardView, board_views
from .features import F64, features_of, matched, sift_extractor
from .footage import Footage, instants_of, open_footage, pictures_at
from .held_out import split
from .lenses import Lens, focal_deviation, lens_from_board
from .structure import Mapped, Matched, map_cameras, require_pycolmap

MIN_CAMERAS = 3
_BOARD_INSTANTS, _INSTANTS = 120, 8
_MIN_EXPLAINED = 0.3
"""Share of matches held out that cameras have to explain. Right ones explain .36 of `panoptic_basketball` and .9 of
`workbench`; on `stage`, with its patterned wallpaper, the best that is found explains .25, and is wrong."""

_MAX_ERROR = 0.001
"""Reprojection error in widths of the picture: a pixel of 1000. By a pixel the finest detail, two pixels wide, is in
opposite phase, and what cameras see together becomes blur. Right calibrations have .1 to .6."""
_MAX_FOCAL_DEVIATION, _NAMED_FOCAL_DEVIATION = 0.02, 0.01
"""Of a focal length that a board gave, as its share: what is left out, and what is named. On `desk_charuco_4cam`, where
the board is in the middle of the pictures, deviations of .002, .015 and .016 come with focal lengths off by 1 to 3 %,
and .044 with one off by 16 %."""

_MAX_FOCAL_ERROR, _NAMED_FOCAL_ERROR = 0.1, 0.02
"""That a focal length from structure from motion may have: what is left out, and what is named (docs/calibrate.md)."""
_LENS_HELP = "add cameras around it, or show all cameras a board (--board)"

OnStep = Callable[[int, int], None]


@dataclass(frozen=True)
class Placed:
    """A camera with its RMS reprojection error in pixels, and the source of its frames."""

    camera: Camera
    error: float
    footage: Footage


@dataclass(frozen=True)
class Calibration:
    """Placed cameras, what would help those that are not, by name, the way they were placed, and the world's unit.

    ``doubts``: what is uncertain about placed cameras, by name.
    """

    placed: tuple[Placed, ...]
    not_connected: Mapping[str, str]
    way: str
    length_unit: str
    doubts: Mapping[str, str] = field(default_factory=dict)


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
        reasons = "; ".join(f"{', '.join(names)}: {help_}" for help_, names in _by_reason(found.not_connected).items())
        raise RigError(f"{videos}: only {len(found.placed)} of {len(footage)} cameras can be placed. {reasons}")
    return _upright(found)


def _by_reason(reasons: Mapping[str, str]) -> dict[str, list[str]]:
    """The cameras' names for each reason."""
    return {help_: [name for name, its in reasons.items() if its == help_] for help_ in dict.fromkeys(reasons.values())}


def _by_board(footage: tuple[Footage, ...], board: Board, count: int, on_step: OnStep) -> Calibration:
    find, corners, instants = BoardFinder(board), board.corners(), instants_of(footage, count)
    views: dict[int, Mapping[int, BoardView]] = {}
    lenses: dict[int, Lens] = {}
    reasons, doubts = {}, {}
    for number, camera in enumerate(footage):
        seen = views[number] = board_views(pictures_at(camera, instants), find)
        lens = lens_from_board(list(seen.values()), corners, camera.size)
        on_step(number + 1, len(footage))
        if lens is None:
            reasons[number] = f"sees the board in {len(seen)} of {len(instants)} frames looked at; show it the board"
            continue
        deviation = _focal_deviation(lens, list(seen.values()), corners, camera.size)
        known = f"known to {100 * deviation:.1f} % only" if np.isfinite(deviation) else "not known"
        doubt = f"its focal length is {known}; show it the board tilted, and all over its picture"
        if deviation > _MAX_FOCAL_DEVIATION:
            reasons[number] = doubt
            continue
        if deviation > _NAMED_FOCAL_DEVIATION:
            doubts[number] = doubt
        lenses[number] = lens
    rig, inaccurate = _placed_accurately(lenses, views, corners, footage)
    reasons |= inaccurate
    placed = []
    for number in sorted(rig.poses):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rig.poses[number][0])[0], rig.poses[number][1]
        found = lenses[number].camera(footage[number].name, footage[number].size, pose)
        placed.append(Placed(found, rig.errors[number], footage[number]))
    for number in range(len(footage)):
        if number not in rig.poses and number not in reasons:
            reasons[number] = _disconnected(views[number], number in rig.inconsistent)
    return Calibration(
        tuple(placed),
        {footage[number].name: reasons[number] for number in sorted(reasons)},
        "board",
        "metre",
        {footage[number].name: doubts[number] for number in sorted(rig.poses) if number in doubts},
    )


def _focal_deviation(lens: Lens, views: list[BoardView], corners: F64, size: tuple[int, int]) -> float:
    """As `focal_deviation`; 0 for a fisheye lens, of which OpenCV does not tell it."""
    return 0.0 if lens.kind == "fisheye" else focal_deviation(views, corners, size)


def _placed_accurately(
    lenses: Mapping[int, Lens],
    views: Mapping[int, Mapping[int, BoardView]],
    corners: F64,
    footage: tuple[Footage, ...],
) -> tuple[BoardRig, dict[int, str]]:
    """Cameras placed by the board, without those whose error is too large: the worst is left out, the rest placed anew.

    Also why those were left out, by number.
    """
    left_out: dict[int, str] = {}
    while True:
        rig = place_by_board({number: lenses[number] for number in lenses if number not in left_out}, views, corners)
        excess = {number: error / (_MAX_ERROR * footage[number].size[0]) for number, error in rig.errors.items()}
        worst = max(excess, key=lambda number: excess[number], default=None)
        if worst is None or excess[worst] <= 1:
            return rig, left_out
        left_out[worst] = _inaccurate(rig.errors[worst], "hold the board still, and synchronise the videos")


def _inaccurate(error: float, help_: str) -> str:
    return f"is off by {error:.1f} px; {help_}"


def _disconnected(views: Mapping[int, BoardView], inconsistent: bool) -> str:
    """Why the board does not place a camera whose lens is known."""
    if inconsistent and any(view.mirrored for view in views.values()):
        return "sees the board mirrored, where other cameras do not have it; is its video mirrored?"
    if inconsistent:
        return "sees the board elsewhere than other cameras at the same frame; synchronise the videos"
    return "never sees the board together with a placed camera; hold it where both see it"


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
    mapped = map_cameras(Matched(names, sizes, features, matches, shared), seed, lambda: on_step(next(ways), total))
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
    reasons = dict.fromkeys(left, f"shares too little with placed cameras; {board}")
    inaccurate = {one.camera.name: one.error for one in placed if one.error > _MAX_ERROR * one.camera.width}
    reasons |= {name: _inaccurate(error, board) for name, error in inaccurate.items()}
    doubts = {
        names[number]: (error, f"its focal length may be off by {_percent(error)}; {_LENS_HELP}")
        for number, error in mapped.focal_errors.items()
        if error > _NAMED_FOCAL_ERROR and names[number] not in reasons
    }
    reasons |= {name: doubt for name, (error, doubt) in doubts.items() if error > _MAX_FOCAL_ERROR}
    kept = tuple(one for one in placed if one.camera.name not in reasons)
    doubts_of_kept = {name: doubt for name, (_, doubt) in doubts.items() if name not in reasons}
    return _scaled(Calibration(kept, reasons, mapped.way, "", doubts_of_kept))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if share < 1 else "anything"


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
