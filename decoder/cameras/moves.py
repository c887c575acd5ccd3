"""Camera moves for a quick look, made from the rig: an orbit and a spiral around the point its cameras look at.

Up is the world's (`formats.up_direction`). The lens is that of the camera in the rig's middle, without distortion. A
move takes at least ``SECONDS``; a shorter stream plays forwards and backwards meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, as_pinhole, camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.geometry.axes import point_nearest_axes
from decogs.formats.geometry.up_direction import up_of

from .fields import pose_of
from .path import DEFAULT_FPS, CameraPath, ToFilm

Move = Literal["orbit", "spiral"]
Vector = NDArray[np.float64]

SECONDS = 4.0
_ALL_ROUND = np.radians(240.0)
"""Angle of the rig about its point from which an orbit goes all the way round: what is behind is seen by no camera."""

_SPIRAL_TURNS = 2
_SPIRAL_SIZE = 0.5
"""Of the rig's extent: new views between its cameras, not beyond them."""


def camera_move(move: Move, film: ToFilm) -> CameraPath:
    """The cameras of a move, with times; raises UsageError for a rig of a single camera."""
    if film.frame_count is None:
        raise UsageError(f"`move` {move}: needs the whole stream; decode its file once it is whole")
    centres = np.array([camera_centre(camera) for camera in film.cameras])
    if len(centres) < 2 or not np.ptp(centres, axis=0).any():
        raise UsageError(f"`move` {move}: needs a rig of at least two places to know how far to go; give a camera path")
    fps = film.fps or DEFAULT_FPS
    count = max(film.frame_count, round(SECONDS * fps))
    lens = as_pinhole(_middle(film.cameras, centres))
    position = (_orbit if move == "orbit" else _spiral)(film.cameras, centres)
    target, up = looked_at(film.cameras), up_of(film.cameras)
    cameras = tuple(
        replace(lens, name=move, world_to_camera=looking(position(k / count), target, up)) for k in range(count)
    )
    return CameraPath(cameras, tuple(map(float, _there_and_back(count, film.frame_count))), None, f"`move` {move}")


def looked_at(cameras: tuple[Camera, ...]) -> Vector:
    """The point (3,) nearest to all optical axes, in the least squares; before the cameras.

    Parallel axes have none: then a point before the rig's centre, as far as the rig is wide.
    """
    centres = np.array([camera_centre(camera) for camera in cameras])
    axes = np.array([camera.world_to_camera[2, :3] for camera in cameras])
    point, is_unique = point_nearest_axes(cameras)
    if is_unique and ((point - centres) * axes).sum() > 0:
        return point
    middle, forward = centres.mean(axis=0), axes.mean(axis=0)
    return np.asarray(middle + forward / np.linalg.norm(forward) * np.linalg.norm(np.ptp(centres, axis=0)))


def looking(position: Vector, target: Vector, up: Vector) -> NDArray[np.float64]:
    """World to camera, of a camera that sees ``target`` in its centre and ``up`` upwards."""
    forward = target - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # straight up or down: any side will do
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
    right = right / np.linalg.norm(right)
    return pose_of(np.stack([right, np.cross(forward, right), forward]), position)


def _orbit(cameras: tuple[Camera, ...], centres: Vector) -> Callable[[float], Vector]:
    """Positions at the cameras' mean distance and height: all the way round, or to and fro where the rig stands."""
    target, up = looked_at(cameras), up_of(cameras)
    out = centres - target
    height = float((out @ up).mean())
    flat = out - (out @ up)[:, None] * up
    radius = float(np.linalg.norm(flat, axis=1).mean())
    front = _unit(flat.mean(axis=0), fallback=flat[0])
    side = np.cross(up, front)
    angles = np.arctan2(flat @ side, flat @ front)
    spread = float(np.ptp(angles))
    gaps = np.diff(np.sort(np.append(angles, angles.min() + 2 * np.pi)))
    all_round = 2 * np.pi - float(gaps.max()) >= _ALL_ROUND

    def position(part: float) -> Vector:
        swing = (
            2 * np.pi * part if all_round else (angles.min() + angles.max()) / 2 + spread / 2 * np.sin(2 * np.pi * part)
        )
        return np.asarray(target + up * height + radius * (np.cos(swing) * front + np.sin(swing) * side))

    return position


def _spiral(cameras: tuple[Camera, ...], centres: Vector) -> Callable[[float], Vector]:
    """Positions around the rig's middle camera, growing and shrinking, towards and away (LLFF's spiral)."""
    target = looked_at(cameras)
    pose = looking(centres.mean(axis=0), target, up_of(cameras))[:3, :3]
    reach = _SPIRAL_SIZE * np.abs((centres - centres.mean(axis=0)) @ pose.T).max(axis=0)
    reach[2] = min(reach[2], 0.2 * float(np.linalg.norm(target - centres.mean(axis=0))))

    def position(part: float) -> Vector:
        turn = 2 * np.pi * _SPIRAL_TURNS * part
        size = np.sin(np.pi * part)
        offset = size * np.array([np.cos(turn), np.sin(turn), np.sin(turn / 2)]) * reach
        return np.asarray(centres.mean(axis=0) + offset @ pose)

    return position


def _middle(cameras: tuple[Camera, ...], centres: Vector) -> Camera:
    """The camera nearest to the rig's middle."""
    return cameras[int(np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin())]


def _there_and_back(count: int, frames: int) -> list[int]:
    """``count`` frames, from the first to the last and back as often as it takes."""
    if frames == 1:
        return [0] * count
    period = 2 * (frames - 1)
    return [min(k % period, period - k % period) for k in range(count)]


def _unit(vector: Vector, *, fallback: Vector) -> Vector:
    length = float(np.linalg.norm(vector))
    if length < 1e-6 * float(np.linalg.norm(fallback)):
        vector, length = fallback, float(np.linalg.norm(fallback))
    return np.asarray(vector / length)
