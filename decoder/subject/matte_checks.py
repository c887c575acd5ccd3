"""Mattes that cannot be what they should: white or black all over, inverted, or another camera's.

Every pixel of a subject lies before a point of space that all cameras see as subject, or do not see: mattes of several
cameras say so of each other. Figures: rig/mattes/DESIGN.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, in_picture, project, ray_slopes, rig_extent
from decogs.formats.errors import RigError
from decogs.formats.splats import FloatArray
from decogs.formats.system.callbacks import OnWarning

_Recorded: TypeAlias = "NDArray[np.bool_] | None"

_ALL, _LEVEL = 0.995, 1 / 255
_MAX_LABEL = 8 / 255
"""Brightest pixel of a matte that was saved as numbers of objects."""
_INVERTED_BORDER = 0.95
"""White share of the border of a matte from which, with less in the middle, it is inverted."""
_SUBJECT, _SURE_SUBJECT = 0.3, 0.9
"""Alpha from which another view's pixel may be subject, and from which one is asked about."""
_MARGIN_WIDTHS, _MIN_MARGIN_PIXELS = 0.005, 1
"""By which mattes are widened before they deny something, in units of the picture's width: poses, steps of depth."""
_PIXELS, _DEPTHS = 60, 512
"""Of a view that are asked about, and of each one's ray; the same every time."""
_NEAREST, _FARTHEST = 0.2, 8.0
"""Of these depths, in units of the rig's size: of a ring, from half way to beyond the other side; of an arc, a room."""
_MIN_VIEWS = 3
_WRONG, _DOUBTFUL, _DENIED = 0.8, 0.85, 0.3
"""Share of a view's subject that the others confirm, all but one of them, below which its matte is wrong; and all of
them, below which someone's is; share of all others' subjects that one denies, from which its own is."""


def check_mattes(
    origins: Sequence[str],
    cameras: Sequence[Camera],
    alphas: Sequence[FloatArray],
    recorded: Sequence[_Recorded],
    warn: OnWarning,
) -> str:
    """How the mattes (H, W) of one frame agree, by ``cameras`` without lenses, in words.

    Raises RigError where they cannot be what they should. ``origins``: where they come from, for messages.
    ``recorded`` (H, W): which pixels were, None meaning all. ``warn`` is called where they contradict each other
    somewhat.
    """
    for origin, alpha, seen in zip(origins, alphas, recorded, strict=True):
        problem = _problem(alpha, seen)
        if problem:
            raise RigError(f"{origin}: {problem}")
    if not any((alpha > _SURE_SUBJECT).any() for alpha in alphas):
        raise RigError(f"{origins[0]} and all others: black all over, there is no subject; white is subject")
    if len(cameras) < _MIN_VIEWS:
        return f"mattes can be right; whether they agree only {_MIN_VIEWS} cameras say"
    return _check_agreement(origins, _agreement(cameras, rig_extent(cameras), alphas, recorded), warn)


def is_white(alpha: FloatArray) -> bool:
    """Whether a matte, of any shape, leaves nothing out, as where a tool found no subject."""
    return bool((alpha > _ALL).mean() > _ALL)


def _problem(alpha: FloatArray, recorded: _Recorded) -> str:
    """Why a matte (H, W) 0..1 is none: white all over, labels of objects, inverted; empty where it may be one."""
    if is_white(alpha if recorded is None else alpha[recorded]):
        return "white all over; white is subject, black is empty"
    if _LEVEL <= alpha.max() <= _MAX_LABEL:
        return f"nowhere brighter than {255 * alpha.max():.0f} of 255, like labels of objects; write white for them"
    border = _border(alpha, recorded)
    height, width = alpha.shape
    middle = alpha[height // 4 : -(height // 4) or None, width // 4 : -(width // 4) or None]
    if (border > _SURE_SUBJECT).mean() > _INVERTED_BORDER and middle.mean() < border.mean():
        return "white at all borders and not in the middle, so inverted; white is subject"
    return ""


def _border(alpha: FloatArray, recorded: _Recorded) -> FloatArray:
    """The values (P,) of a matte (H, W) at the border of what was recorded."""
    import cv2

    if recorded is None:
        return np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
    inner = cv2.erode(recorded.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
    return np.asarray(alpha[recorded & (inner == 0)])


def _check_agreement(origins: Sequence[str], agreement: _Agreement, warn: OnWarning) -> str:
    denying, wrong = int(agreement.denied.argmax()), int(agreement.by_all_but_one.argmin())
    if agreement.by_all_but_one[wrong] < _WRONG:
        raise RigError(
            f"{origins[wrong]}: the other cameras' mattes confirm only {agreement.by_all_but_one[wrong]:.0%} of its "
            "subject; is it another camera's, mirrored, or of another frame?"
        )
    if agreement.denied[denying] > _DENIED:
        raise RigError(
            f"{origins[denying]}: leaves out {agreement.denied[denying]:.0%} of what all other cameras' mattes have; "
            "draw it whole, or hold the camera out"
        )
    if agreement.by_all.min() < _DOUBTFUL:
        warn(
            f"{origins[denying]}: mattes contradict each other, this one most, and what one leaves out is lost in all: "
            f"at worst {agreement.by_all.min():.0%} of a camera's subject stays"
        )
        return "mattes agree in part"
    return f"mattes agree: of a camera's subject the others confirm {agreement.by_all.min():.0%} at least"


@dataclass(frozen=True)
class _Agreement:
    """Of each view (V,): the share of its subject that all others confirm, that all others but one do, and the share of
    the others' subjects that it alone denies."""

    by_all: NDArray[np.float64]
    by_all_but_one: NDArray[np.float64]
    denied: NDArray[np.float64]


def _agreement(
    cameras: Sequence[Camera], extent: float, alphas: Sequence[FloatArray], recorded: Sequence[_Recorded]
) -> _Agreement:
    may_be = [_with_margin(alpha) for alpha in alphas]
    depths = np.geomspace(_NEAREST * extent, _FARTHEST * extent, _DEPTHS)
    confirmed, denied, asked = np.ones((2, len(cameras))), np.zeros(len(cameras)), 0
    for row, (camera, alpha, shown) in enumerate(zip(cameras, alphas, recorded, strict=True)):
        subject = alpha > _SURE_SUBJECT
        pixels = np.flatnonzero(subject if shown is None else subject & shown)
        if not pixels.size:
            continue
        chosen = pixels[np.linspace(0, pixels.size - 1, min(_PIXELS, pixels.size)).astype(np.int64)]
        points = _along_rays(camera, chosen, depths)
        seen, missed = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
        last = np.full(len(points), -1)
        for index, (other, subject, shown) in enumerate(zip(cameras, may_be, recorded, strict=True)):
            if index != row:
                u, v, depth = project(other, points)
                here = np.flatnonzero(in_picture(other, u, v, depth))
                if shown is not None:
                    here = here[shown[v[here].astype(np.int64), u[here].astype(np.int64)]]
                seen[here] += 1
                misses = here[~subject[v[here].astype(np.int64), u[here].astype(np.int64)]]
                missed[misses] += 1
                last[misses] = index
        rays, is_seen = (len(chosen), -1), seen >= _MIN_VIEWS - 1
        by_all = (is_seen & (missed == 0)).reshape(rays).any(axis=1)
        confirmed[:, row] = by_all.mean(), (is_seen & (missed <= 1)).reshape(rays).any(axis=1).mean()
        by_others = np.where(is_seen & (missed == 1), last, -1).reshape(rays)[~by_all]
        denied += [np.count_nonzero((by_others == index).any(axis=1)) for index in range(len(cameras))]
        asked += len(chosen)
    return _Agreement(confirmed[0], confirmed[1], denied / max(asked, 1))


def _with_margin(alpha: FloatArray) -> NDArray[np.bool_]:
    import cv2

    reach = max(_MIN_MARGIN_PIXELS, round(_MARGIN_WIDTHS * alpha.shape[1]))
    return np.asarray(cv2.dilate((alpha > _SUBJECT).astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8)) > 0)


def _along_rays(camera: Camera, pixels: NDArray[np.int64], depths: NDArray[np.float64]) -> FloatArray:
    """Points (P, 3) at all depths of each pixel."""
    y, x = np.divmod(pixels, camera.width)
    ways = np.stack([*ray_slopes(camera, x + 0.5, y + 0.5), np.ones(len(pixels))])
    seen = (ways[:, :, None] * depths).reshape(3, -1)
    world = camera.world_to_camera[:3, :3].T @ (seen - camera.world_to_camera[:3, 3:])
    return np.asarray(world.T, np.float32)
