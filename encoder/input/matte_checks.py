"""Mattes that cannot be what they should: white or black all over, inverted, or another camera's.

Every pixel of a subject lies before a point of space that all cameras see as subject, or do not see: mattes of several
cameras say so of each other. Figures: DESIGN.md, "Mattes".
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.callbacks import OnWarning
from decogs.formats.cameras import Camera, in_picture, project, ray_slopes
from decogs.formats.errors import RigError
from decogs.formats.splats import FloatArray

from .ingest import Ingest, scene_extent

_ALL, _LEVEL = 0.995, 1 / 255
_MAX_LABEL = 8 / 255
"""Brightest pixel of a matte that was saved as numbers of objects."""
_INVERTED_BORDER = 0.95
"""White share of the border of a matte from which, with less in the middle, it is inverted."""
_SUBJECT, _SURE_SUBJECT = 0.3, 0.9
"""Alpha from which another view's pixel may be subject, and from which one is asked about."""
_MARGIN_PIXELS = 2
_PIXELS, _DEPTHS = 100, 256
"""Of a view that are asked about, and of each one's ray; the same every time."""
_NEAREST, _FARTHEST = 0.2, 8.0
"""Of these depths, in units of the rig's size: of a ring, from half way to beyond the other side; of an arc, a room."""
_MIN_VIEWS = 3
_WRONG, _DOUBTFUL = 0.8, 0.85
"""Share of a view's subject that the others confirm, all but one of them, below which the matte is wrong; and all of
them, below which someone's is."""


def check_mattes(ingest: Ingest, frame: int, warn: OnWarning) -> None:
    """Raises RigError where the mattes of ``frame`` cannot be what they should; nothing where there are none."""
    if not ingest.has_mattes:
        return
    views, alphas = ingest.views, next(ingest.frames(frame, frame + 1)).alpha
    for view, alpha in zip(views, alphas, strict=True):
        problem = _problem(alpha)
        if problem:
            raise RigError(f"matte of camera {view.camera.name}, frame {frame}: {problem}")
    if not any((alpha > _SURE_SUBJECT).any() for alpha in alphas):
        raise RigError(f"mattes of frame {frame}: all are black, there is no subject; white is subject")
    if len(views) < _MIN_VIEWS:
        return
    by_all, by_all_but_one = _confirmed([view.pinhole for view in views], scene_extent(views), alphas)
    worst = int(np.argmin(by_all_but_one))
    if by_all_but_one[worst] < _WRONG:
        raise RigError(
            f"matte of camera {views[worst].camera.name}, frame {frame}: the other cameras' mattes confirm only "
            f"{by_all_but_one[worst]:.0%} of its subject; is it another camera's, mirrored, or of another frame?"
        )
    if by_all.min() < _DOUBTFUL:
        name = views[int(np.argmin(by_all))].camera.name
        warn(
            f"frame {frame}: mattes contradict each other, most that of camera {name}, {by_all.min():.0%} of whose "
            "subject is subject in all others; what one leaves out is gone in all"
        )


def _problem(alpha: FloatArray) -> str:
    if (alpha > _ALL).mean() > _ALL:
        return "white all over; white is subject, black is empty"
    if _LEVEL <= alpha.max() <= _MAX_LABEL:
        return f"nowhere brighter than {255 * alpha.max():.0f} of 255, like labels of objects; write white for them"
    border = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
    height, width = alpha.shape
    middle = alpha[height // 4 : -(height // 4) or None, width // 4 : -(width // 4) or None]
    if (border > _SURE_SUBJECT).mean() > _INVERTED_BORDER and middle.mean() < border.mean():
        return "white at all borders and not in the middle, so inverted; white is subject"
    return ""


def _confirmed(
    cameras: Sequence[Camera], extent: float, alphas: Sequence[FloatArray]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Of each view's subject, the share that all other views confirm, and the share that all but one do."""
    size = np.ones((2 * _MARGIN_PIXELS + 1,) * 2, np.uint8)
    may_be = [cv2.dilate((alpha > _SUBJECT).astype(np.uint8), size) > 0 for alpha in alphas]
    depths = np.geomspace(_NEAREST * extent, _FARTHEST * extent, _DEPTHS)
    confirmed = np.ones((2, len(cameras)))
    for row, (camera, alpha) in enumerate(zip(cameras, alphas, strict=True)):
        pixels = np.flatnonzero(alpha.ravel() > _SURE_SUBJECT)
        if not pixels.size:
            continue
        chosen = pixels[np.linspace(0, pixels.size - 1, min(_PIXELS, pixels.size)).astype(np.int64)]
        points = _along_rays(camera, chosen, depths)
        seen, missed = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
        for index, (other, subject) in enumerate(zip(cameras, may_be, strict=True)):
            if index != row:
                u, v, depth = project(other, points)
                here = np.flatnonzero(in_picture(other, u, v, depth))
                seen[here] += 1
                missed[here] += ~subject[v[here].astype(np.int64), u[here].astype(np.int64)]
        for which in (0, 1):
            held = ((seen >= _MIN_VIEWS - 1) & (missed <= which)).reshape(len(chosen), -1)
            confirmed[which, row] = held.any(axis=1).mean()
    return confirmed[0], confirmed[1]


def _along_rays(camera: Camera, pixels: NDArray[np.int64], depths: NDArray[np.float64]) -> FloatArray:
    """Points (P, 3) at all depths of each pixel."""
    y, x = np.divmod(pixels, camera.width)
    ways = np.stack([*ray_slopes(camera, x + 0.5, y + 0.5), np.ones(len(pixels))])
    seen = (ways[:, :, None] * depths).reshape(3, -1)
    world = camera.world_to_camera[:3, :3].T @ (seen - camera.world_to_camera[:3, 3:])
    return np.asarray(world.T, np.float32)
