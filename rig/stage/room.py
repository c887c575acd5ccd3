"""Walls that are plain in most views: their points, and the pixels beside them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.subject.hull import BoolArray
from decogs.formats.cameras import Camera, camera_centre, in_picture, project

from .surfaces import F64, PlainView, nearest_of, plain_colours

_MIN_PLAIN_VIEWS = 0.35
"""Least share of the views of a point of the wall that show it as plain: performers stand before it in others."""


def plain_points(views: Sequence[PlainView], xyz: F64, normals: F64) -> BoolArray:
    """Points (P, 3) of the wall that enough views show as plain; those that no view shows are as the nearest one."""
    looks, plain = np.zeros(len(xyz)), np.zeros(len(xyz))
    for view in views:
        looks[_facing(view.camera, xyz, normals)[0]] += 1
        plain[plain_colours(view, xyz, normals)[0]] += 1
    shown, seen = plain >= _MIN_PLAIN_VIEWS * looks, looks > 0
    if seen.any() and not seen.all():
        shown[~seen] = shown[seen][nearest_of(xyz[seen], xyz[~seen])]
    return np.asarray(shown)


def pixels_beside(camera: Camera, xyz: F64, normals: F64, wall: BoolArray) -> BoolArray:
    """Pixels (H, W) whose nearest one of the points (P, 3) on surfaces is none of the ``wall``."""
    rows, pixels = _facing(camera, xyz, normals)
    if not len(rows):
        return np.ones((camera.height, camera.width), bool)
    grid = np.stack(np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5), axis=-1)
    nearest = nearest_of(pixels, grid.reshape(-1, 2))
    return np.asarray(~wall[rows[nearest]].reshape(camera.height, camera.width))


def _facing(camera: Camera, xyz: F64, normals: F64) -> tuple[NDArray[np.int64], F64]:
    """Rows of the points that face the camera in its picture, and their pixels (R, 2)."""
    u, v, depth = project(camera, xyz)
    facing = (normals * (camera_centre(camera) - xyz)).sum(axis=1) > 0
    rows = np.flatnonzero(in_picture(camera, u, v, depth) & facing)
    return rows, np.stack([u[rows], v[rows]], axis=1)
