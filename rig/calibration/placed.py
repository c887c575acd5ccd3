"""Cameras as they were placed, and turned and scaled into the world that is written."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal, get_args

import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.geometry.up_direction import AXES, turn_between, up_of

from .features import F64
from .footage import Footage

OnStep = Callable[[int, int], None]
Edge = Literal["auto", "top", "bottom", "left", "right"]
"""Of the pictures: the one that points up in the world."""
EDGES: tuple[Edge, ...] = get_args(Edge)

MIN_CAMERAS = 3
"""Of a rig."""
MAX_ERROR = 0.001
"""Reprojection error in widths of the picture: a pixel of 1000. By a pixel the finest detail, two pixels wide, is in
opposite phase, and what cameras see together becomes blur. Right calibrations have .1 to .6."""


_METRES = 0.001, 1000.0
"""Between two cameras of a rig; whoever states millimetres states more."""


@dataclass(frozen=True)
class Placed:
    """A camera with its RMS reprojection error in pixels, and the source of its frames."""

    camera: Camera
    error: float
    footage: Footage


@dataclass(frozen=True)
class Calibration:
    """Placed cameras, what would help those that are not, by name, the way they were placed, and the world's unit.

    ``doubts``: what is uncertain about placed cameras, by name. ``links``: how many points (with a board: instants) two
    cameras share, by their names. ``points`` (P, 3): what the cameras see, in the world. ``warnings``: of their starts.
    """

    placed: tuple[Placed, ...]
    not_connected: Mapping[str, str]
    way: str
    length_unit: str
    doubts: Mapping[str, str] = field(default_factory=dict)
    links: Mapping[tuple[str, str], int] = field(default_factory=dict)
    points: F64 = field(default_factory=lambda: np.zeros((0, 3)))
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Distance:
    """Between the centres of two cameras, metres."""

    first: str
    second: str
    metres: float


def parse_distance(text: str) -> Distance:
    """``CAM_A:CAM_B:METRES``. Raises UsageError."""
    first, second, metres = [*text.rsplit(":", 2), "", ""][:3]
    try:
        length = float(metres)
    except ValueError:
        length = 0.0
    if not (first and second and first != second and _METRES[0] <= length < _METRES[1]):
        raise UsageError(
            f"`distance` {text!r}: expected two cameras and metres between them, {_METRES[0]:g} to {_METRES[1]:g}, "
            "such as cam00:cam01:2.35"
        )
    return Distance(first, second, length)


def by_reason(reasons: Mapping[str, str]) -> dict[str, str]:
    """The cameras' names, with commas between them, for each reason."""
    every = dict.fromkeys(reasons.values())
    return {reason: ", ".join(name for name, its in reasons.items() if its == reason) for reason in every}


def inaccurate(error: float, help_: str) -> str:
    """Why a camera with too large an error is left out."""
    return f"is off by {error:.1f} px; {help_}"


def normalise_scale(calibration: Calibration) -> Calibration:
    """With 1 as the mean distance of two cameras."""
    centres = [camera_centre(placed.camera) for placed in calibration.placed]
    distances = [float(np.linalg.norm(one - two)) for one, two in combinations(centres, 2)]
    return _moved(calibration, np.eye(3), 1 / float(np.mean(distances))) if distances else calibration


def scale_to_distance(calibration: Calibration, distance: Distance) -> Calibration:
    """In metres, by a known distance. Raises UsageError where it is not between two placed cameras."""
    centres = {one.camera.name: camera_centre(one.camera) for one in calibration.placed}
    check_named(distance, centres)
    length = float(np.linalg.norm(centres[distance.first] - centres[distance.second]))
    if length == 0:
        raise UsageError(f"`distance` from {distance.first} to {distance.second}: they stand in one place")
    return replace(_moved(calibration, np.eye(3), distance.metres / length), length_unit="metre")


def check_named(distance: Distance, cameras: Collection[str]) -> None:
    """Raises UsageError where a distance is not between two of these cameras."""
    for name in (distance.first, distance.second):
        if name not in cameras:
            raise UsageError(f"`distance` from {name}: there are {', '.join(cameras)}; measure between two of these")


def rotate_up(calibration: Calibration, edge: Edge) -> Calibration:
    """Turned so that up is -Y, as in COLMAP's worlds; up is where most pictures have their ``edge``."""
    up = up_of([_rolled(placed.camera, edge) for placed in calibration.placed])
    return _moved(calibration, turn_between(up, AXES["-Y"]), 1.0)


def _rolled(camera: Camera, edge: Edge) -> Camera:
    """The camera turned about its axis, so that its picture's ``edge`` is on top."""
    quarters = {"auto": 0, "top": 0, "left": 1, "bottom": 2, "right": 3}[edge]
    quarter = np.array([[0.0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    return replace(camera, world_to_camera=np.linalg.matrix_power(quarter, quarters) @ camera.world_to_camera)


def _moved(calibration: Calibration, rotation: F64, scale: float) -> Calibration:
    """In a world that is turned, scaled, and has the middle of the cameras as its origin."""
    middle = np.mean([camera_centre(placed.camera) for placed in calibration.placed], axis=0)

    def moved(camera: Camera) -> Camera:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] = scale * (pose[:3, 3] + pose[:3, :3] @ middle)
        pose[:3, :3] = pose[:3, :3] @ rotation.T
        return replace(camera, world_to_camera=pose)

    return replace(
        calibration,
        placed=tuple(replace(one, camera=moved(one.camera)) for one in calibration.placed),
        points=scale * (calibration.points - middle) @ rotation.T,
    )
