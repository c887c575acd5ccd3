"""A subject cut out of a picture whose backdrop is known: alpha, and the subject's own colours.

Edge pixels are a mixture of subject and backdrop: C = alpha F + (1 - alpha) B in linear light, where F is any of the
subject's colours nearby that explains C; alpha is the mean over these, and then follows the picture's edges. Sources:
Smith and Blinn 1996, "Blue Screen Matting"; Wang and Cohen 2007, "Optimized Color Sampling for Robust Matting".
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from .filling import shrunk_and_filled
from .outlines import fitted

BoolArray = NDArray[np.bool_]

_EDGE_WIDTHS, _MIN_EDGE_PIXELS = 0.004, 2
"""Reach of mixed pixels from the backdrop, in units of the picture's width: a lens's and a codec's blur."""
_SAMPLED_REACHES = 2
"""Distance up to which a mixed pixel takes the subject's colours, in units of that reach."""
_DEVIATION = 0.02
"""Of linear colours that explain a mixed one."""
_CLIPPED = 0.1
"""Alpha below which a pixel is backdrop, and likewise subject: noise and compression."""
_LEAST_CONTRAST = 1e-5
"""Square of a difference of linear colours that says nothing of alpha."""
_MIN_ALPHA = 0.1
"""Below it, a mixture tells too little of the subject's colour."""


@dataclass(frozen=True)
class Subject:
    """What stands in front of a backdrop: ``alpha`` (H, W) 0..1, and its ``colours`` (H, W, 3), linear, everywhere."""

    alpha: FloatArray
    colours: FloatArray


def cut_out(picture: FloatArray, plate: FloatArray, backdrop: BoolArray) -> Subject:
    """The subject in ``picture`` before ``plate``, both (H, W, 3) in linear light; ``backdrop`` (H, W): where none is.

    Pixels of the backdrop beside the subject may be mixtures, too.
    """
    mask = backdrop.astype(np.uint8)
    reach = _reach(picture)
    inside = cv2.dilate(mask, _disc(reach)) == 0
    outside = cv2.erode(mask, _disc(1), borderValue=1) > 0
    continued = _continued(picture, inside, reach)
    alpha = inside.astype(np.float32)
    rows, columns = np.nonzero(~inside & ~outside)
    alpha[rows, columns] = _mixed(picture, plate, inside, (rows, columns), continued[rows, columns], reach)
    alpha = _along_outline(picture, alpha, reach)
    return Subject(alpha, _unmixed(picture, alpha, plate, continued))


def with_alpha(picture: FloatArray, alpha: FloatArray) -> Subject:
    """The subject in ``picture`` (H, W, 3), linear, of which ``alpha`` (H, W) is known and the backdrop is not.

    The backdrop goes on behind outlines as it is beside them.
    """
    reach = _reach(picture)
    behind, continued = (_continued(picture, where, reach) for where in (alpha <= 0, alpha >= 1))
    return Subject(alpha, _unmixed(picture, alpha, behind, continued))


def _along_outline(picture: FloatArray, guess: FloatArray, reach: int) -> FloatArray:
    """Alpha (H, W): the ``guess``, made to follow the picture's edges near its outline."""
    subject, near = (guess > 0.5).astype(np.uint8), _disc(max(1, reach // 2))
    outline = (cv2.dilate(subject, near) > 0) & (cv2.erode(subject, near) == 0)
    clear = _clear(guess)
    return np.where(outline, _clear(fitted(picture, clear, outline)), clear)


def _clear(alpha: FloatArray) -> FloatArray:
    return np.asarray(np.clip((alpha - _CLIPPED) / (1 - 2 * _CLIPPED), 0, 1), np.float32)


def _unmixed(picture: FloatArray, alpha: FloatArray, plate: FloatArray, continued: FloatArray) -> FloatArray:
    """The subject's own colours (H, W, 3); ``continued`` where there is none of it."""
    part = alpha[..., None]
    own = (picture - (1 - part) * plate) / np.maximum(part, np.float32(_MIN_ALPHA))
    return np.asarray(np.where(part > 0, np.maximum(own, 0), continued), np.float32)


def _reach(picture: FloatArray) -> int:
    return max(_MIN_EDGE_PIXELS, round(_EDGE_WIDTHS * int(picture.shape[1])))


def _disc(radius: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)


def _continued(picture: FloatArray, inside: BoolArray, reach: int) -> FloatArray:
    """The colours inside, smoothed and going on all around."""
    height, width = inside.shape
    size = max(1, width // reach), max(1, height // reach)
    filled = shrunk_and_filled(picture, inside.astype(np.float32), size)
    return np.asarray(cv2.resize(filled, (width, height)), np.float32)


def _mixed(
    picture: FloatArray,
    plate: FloatArray,
    inside: BoolArray,
    pixels: tuple[NDArray[np.int64], NDArray[np.int64]],
    usual: FloatArray,
    reach: int,
) -> FloatArray:
    """Alpha (P,) of mixed pixels by the subject's colours around, or the ``usual`` ones (P, 3) where there are none."""
    (rows, columns), (height, width) = pixels, inside.shape
    seen, behind = picture[rows, columns] - plate[rows, columns], plate[rows, columns]
    alpha, _ = _explained(seen, usual - behind)
    total = np.full(len(rows), 1e-12, np.float32)
    alpha *= total
    farthest, step = _SAMPLED_REACHES * reach, max(1, reach // 2)
    around = np.arange(-farthest, farthest + 1, step)
    for down, across in ((y, x) for y in around for x in around if y * y + x * x <= farthest**2):
        pixel = np.clip(rows + down, 0, height - 1), np.clip(columns + across, 0, width - 1)
        each, rest = _explained(seen, picture[pixel] - behind)
        weight = inside[pixel] * (np.exp(-rest / np.float32(2 * _DEVIATION**2)) + np.float32(1e-9))
        alpha, total = alpha + weight * each, total + weight
    return np.asarray(alpha / total, np.float32)


def _explained(seen: FloatArray, subject: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The alpha (P,) of ``subject`` that explains what is ``seen``, both (P, 3) less the plate; the rest squared."""
    contrast = np.maximum(_products(subject, subject), np.float32(_LEAST_CONTRAST))
    alpha = np.clip(_products(seen, subject) / contrast, 0, 1)
    rest = seen - alpha[:, None] * subject
    return alpha, _products(rest, rest)


def _products(one: FloatArray, other: FloatArray) -> FloatArray:
    """Of the rows, (P,)."""
    return np.asarray(np.einsum("pc,pc->p", one, other))
