"""Finds lenses and places of a rig's cameras from their videos."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from decogs.formats.cameras import Camera
from decogs.formats.errors import RigError, UsageError
from decogs.formats.system.threads import thread_count

from ..parallel import side_by_side
from .boards import Board
from .by_board import lenses_by_board, place_with_board
from .by_motion import place_by_motion
from .footage import check_copies, open_footage, unequal_lengths, unread_beside
from .given import given_lenses
from .placed import (
    MIN_CAMERAS,
    Calibration,
    Distance,
    Edge,
    OnStep,
    by_reason,
    check_named,
    rotate_up,
    scale_to_distance,
)
from .starts import brought_in_step


def calibrate(
    videos: Path,
    *,
    board: Board | None = None,
    frames: int | None = None,
    seed: int = 0,
    shared_intrinsics: bool = False,
    intrinsics: Path | None = None,
    distance: Distance | None = None,
    up: Edge = "auto",
    sync: str | None = None,
    threads: int = 0,
    on_step: OnStep = lambda done, total: None,
) -> Calibration:
    """Places the cameras whose videos are in a folder.

    ``frames``: instants of the take that are looked at. ``intrinsics``: a file with lenses, which stay. The unit is the
    metre with a board or a ``distance``; else the mean distance of two cameras is 1. Up, where most pictures have the
    edge ``up``, is -Y. ``sync``: "auto" or a sync.json brings the videos in step first. ``threads``: 0 means all
    processors; results do not depend on it. Raises RigError where fewer than three cameras can be placed, with what
    would help, and UsageError for lenses that do not suit the videos.
    """
    footage = open_footage(videos)
    if len(footage) < MIN_CAMERAS:
        names = ", ".join(camera.name for camera in footage)
        unread = unread_beside(videos, footage)
        raise RigError(
            f"{videos}: holds {len(footage)} cameras ({names}), and a rig needs {MIN_CAMERAS}; add videos"
            + (f", or convert {unread}, which is not read" if unread else "")
        )
    if board is not None and distance is not None:
        raise UsageError("`distance`: a board says what a metre is; leave one of them away")
    if board is not None and shared_intrinsics:
        raise UsageError("`shared_intrinsics`: a board gives each camera a lens of its own; leave one of them away")
    if intrinsics is not None and shared_intrinsics:
        raise UsageError("`intrinsics`: says which cameras share a lens; leave `shared_intrinsics` away")
    if distance is not None:
        check_named(distance, [camera.name for camera in footage])
    given = None if intrinsics is None else given_lenses(intrinsics, footage)
    warnings: tuple[str, ...] = ()
    if sync is not None:
        footage, warnings = brought_in_step(videos, footage, sync, threads)
    check_copies(footage)
    warnings = (*warnings, *unequal_lengths(footage))
    with side_by_side(thread_count(threads)) as each:
        if board is not None:
            calibration = place_with_board(footage, board, frames, given, each, on_step)
        else:
            calibration = place_by_motion(
                footage, frames=frames, seed=seed, shared=shared_intrinsics, given=given, each=each, on_step=on_step
            )
    if len(calibration.placed) < MIN_CAMERAS:
        raise RigError(
            f"{videos}: only {len(calibration.placed)} of {len(footage)} cameras can be placed. "
            f"{_summary(calibration.not_connected)}"
        )
    placed = rotate_up(calibration if distance is None else scale_to_distance(calibration, distance), up)
    return replace(placed, warnings=warnings)


def calibrate_lenses(
    photos: Path,
    board: Board,
    frames: int | None = None,
    *,
    threads: int = 0,
    on_step: OnStep = lambda done, total: None,
) -> tuple[dict[str, tuple[Camera, float]], dict[str, str], str]:
    """Lenses alone, from pictures of a board that need not be of one instant: cameras at the origin, and errors, px.

    Also what is uncertain about them, by name, and the board that was seen, in words. Raises RigError where a camera's
    pictures do not give its lens.
    """
    footage = open_footage(photos)
    with side_by_side(thread_count(threads)) as each:
        lenses = lenses_by_board(footage, board, frames, None, each, on_step)
    if lenses.reasons:
        reasons = {footage[number].name: reason for number, reason in lenses.reasons.items()}
        raise RigError(f"{photos}: not every lens can be found. {_summary(reasons)}")
    cameras = {
        number: lens.camera(footage[number].name, footage[number].size, np.eye(4))
        for number, lens in lenses.lenses.items()
    }
    doubts = {footage[number].name: doubt for number, doubt in lenses.doubts.items()}
    return {camera.name: (camera, lenses.errors[number]) for number, camera in cameras.items()}, doubts, lenses.way


def _summary(reasons: Mapping[str, str]) -> str:
    return "; ".join(f"{names}: {reason}" for reason, names in by_reason(reasons).items())
