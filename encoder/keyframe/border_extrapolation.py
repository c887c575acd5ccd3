"""Gaussians beside what the training pictures recorded: its borders extrapolated, blurred, instead of black.

A free viewpoint sees past the borders of all pictures. Depths go on as planes, colours as means over more and more of
the border, so that detail fades with the distance from it. No picture contradicts these Gaussians: none is inside what
was recorded of one. Rejected: a background of the pictures' mean colour, which shows through surfaces in training.
Figures: DESIGN.md, "Keyframe".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.resizing import resized, resized_plane
from decogs.formats.cameras import Camera, camera_centre, in_picture, project, ray_directions, scale_camera
from decogs.formats.splats import FloatArray, Splats, round_splats
from decogs.rig.mattes.filling import push_pull
from decogs.rig.pictures.ingest import View

from ..backends import TrainingKernel
from .first_points.depth_filling import fill_depths

_SHRUNK_PIXELS_ACROSS = 96
"""Pixels of a shrunk picture's width: what goes on is blurred."""
_SPACING_PIXELS, _SPACING_GROWTH = 3, 1.25
"""Distance of the Gaussians in shrunk pictures, in pixels, and its factor while there are too many."""
_RINGS = ((0.0, 0.33, 1), (0.33, 1.0, 2))
"""Begin and end in the margin, as shares of it, and the factor of the spacing there."""
_SIGMA_SPACINGS = 0.6
"""Their sigma in units of this distance: together they are closed."""
_CLEARANCE_SIGMAS = 1.0
"""Distance from every picture, in sigmas: what reaches in changes a picture that is trained already."""
_BLOB_OPACITY = 0.9
_SURFACE_OPACITY = 0.5
"""Opacity from which a pixel's depth is that of a surface."""


@dataclass(frozen=True)
class _WidePicture:
    """A shrunk picture with a margin of ``margin`` pixels on every side, into which it goes on.

    ``beside`` (H, W): pixels to the nearest one that was recorded, along rows and columns; ``inverse_depth`` (H, W),
    1 / world units; ``rgb`` (H, W, 3), 0..1.
    """

    camera: Camera
    margin: int
    beside: NDArray[np.float64]
    inverse_depth: FloatArray
    rgb: FloatArray


@dataclass(frozen=True)
class _Blobs:
    """``xyz`` (P, 3) world, ``rgb`` (P, 3) 0..1, ``sigma`` (P,) world units."""

    xyz: NDArray[np.float64]
    rgb: FloatArray
    sigma: NDArray[np.float64]


def border_extrapolation(
    kernel: TrainingKernel,
    views: Sequence[View],
    pictures: Sequence[FloatArray],
    splats: Splats,
    *,
    reach: float,
    most: int,
) -> Splats:
    """At most ``most`` Gaussians outside all views, up to ``reach`` of a picture's width beside the pictures.

    ``pictures`` (3, H, W) are those of ``views``; depths are those of the trained ``splats``.
    """
    wide = [_widened(kernel, *each, splats, reach) for each in zip(views, pictures, strict=True)]
    cell = float(_SPACING_PIXELS)
    blobs = _blobs_beside(views, wide, cell)
    while len(blobs.xyz) > most:
        cell *= _SPACING_GROWTH
        blobs = _blobs_beside(views, wide, cell)
    return round_splats(blobs.xyz, blobs.rgb, blobs.sigma, np.full(len(blobs.xyz), _BLOB_OPACITY), splats.sh_degree)


def _widened(kernel: TrainingKernel, view: View, picture: FloatArray, splats: Splats, reach: float) -> _WidePicture:
    camera = scale_camera(view.pinhole, min(1.0, _SHRUNK_PIXELS_ACROSS / view.pinhole.width))
    margin = round(reach * camera.width)
    wide = replace(
        camera,
        width=camera.width + 2 * margin,
        height=camera.height + 2 * margin,
        cx=camera.cx + margin,
        cy=camera.cy + margin,
    )
    rendered = kernel.forward(splats, camera, depth=True)
    assert rendered.depth is not None
    recorded = np.ones_like(rendered.alpha) if view.valid is None else resized_plane(view.valid, camera)
    solid = (rendered.alpha >= _SURFACE_OPACITY) & (rendered.depth > 0) & (recorded > 0.999)
    inverse = np.divide(rendered.alpha, rendered.depth, out=np.zeros_like(rendered.depth), where=solid)
    colours = resized(picture, camera).transpose(1, 2, 0)
    border = ((margin, margin), (margin, margin))
    padded = np.pad(inverse, border)
    return _WidePicture(
        wide,
        margin,
        _pixels_beside(np.pad(recorded > 0.999, border)),
        fill_depths(padded) if solid.any() else padded,
        push_pull(np.pad(colours, (*border, (0, 0))), np.pad(recorded, border)),
    )


def _blobs_beside(views: Sequence[View], wide: Sequence[_WidePicture], distance: float) -> _Blobs:
    """One in each empty cell of a margin, outside all views."""
    blobs = _Blobs(np.zeros((0, 3)), np.zeros((0, 3), np.float32), np.zeros(0))
    pictures = [(view.pinhole, None if view.recorded is None else _pixels_beside(view.recorded)) for view in views]
    for begin, end, factor in _RINGS:
        cell = round(factor * distance)
        for picture in wide:
            row, column = _free_cells(picture, blobs.xyz, cell, begin, end)
            more = _blobs_at(picture, row, column, cell)
            unseen = ~_reach_into_pictures(pictures, more)
            blobs = _Blobs(
                np.concatenate([blobs.xyz, more.xyz[unseen]]),
                np.concatenate([blobs.rgb, more.rgb[unseen]]),
                np.concatenate([blobs.sigma, more.sigma[unseen]]),
            )
    return blobs


def _pixels_beside(recorded: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Distance (H, W) of each pixel to the nearest one that was ``recorded``, the larger one along row and column."""
    return np.asarray(cv2.distanceTransform((~recorded).astype(np.uint8), cv2.DIST_C, cv2.DIST_MASK_3), np.float64)


def _reach_into_pictures(
    pictures: Sequence[tuple[Camera, NDArray[np.float64] | None]], blobs: _Blobs
) -> NDArray[np.bool_]:
    """Which of them, (P,), reach into what was recorded of a picture: all of it, or where `_pixels_beside` are 0."""
    reaching = np.zeros(len(blobs.xyz), np.bool_)
    for camera, beside in pictures:
        u, v, depth = project(camera, blobs.xyz)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = (_CLEARANCE_SIGMAS * focal * blobs.sigma / depth for focal in (camera.fx, camera.fy))
        here = (depth > 0) & (u > -x) & (u < camera.width + x) & (v > -y) & (v < camera.height + y)
        if beside is not None:
            column = np.clip(np.where(here, u, 0), 0, camera.width - 1).astype(np.int64)
            row = np.clip(np.where(here, v, 0), 0, camera.height - 1).astype(np.int64)
            here &= beside[row, column] < np.maximum(x, y)
        reaching |= here
    return reaching


def _free_cells(
    picture: _WidePicture, xyz: NDArray[np.float64], cell: int, begin: float, end: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (P,) of the middles of cells that hold none of the points, from ``begin`` to ``end`` of the
    margin beside what was recorded."""
    camera, margin = picture.camera, picture.margin
    taken = np.zeros((-(-camera.height // cell), -(-camera.width // cell)), np.bool_)
    u, v, depth = project(camera, xyz)
    inside = in_picture(camera, u, v, depth)
    taken[v[inside].astype(np.int64) // cell, u[inside].astype(np.int64) // cell] = True
    row, column = (axis.ravel() for axis in np.mgrid[cell // 2 : camera.height : cell, cell // 2 : camera.width : cell])
    off = picture.beside[row, column] / max(margin, 1)
    free = (off > begin) & (off <= end) & ~taken[row // cell, column // cell]
    free &= picture.inverse_depth[row, column] > 1e-12
    return row[free], column[free]


def _blobs_at(picture: _WidePicture, row: NDArray[np.int64], column: NDArray[np.int64], cell: int) -> _Blobs:
    camera = picture.camera
    depth = 1 / picture.inverse_depth[row, column].astype(np.float64)
    rays = ray_directions(camera, column + 0.5, row + 0.5)
    return _Blobs(
        camera_centre(camera) + rays * depth[:, None],
        picture.rgb[row, column],
        _SIGMA_SPACINGS * cell * depth / np.sqrt(camera.fx * camera.fy),
    )
