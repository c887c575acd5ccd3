"""A subject cut out of a picture whose backdrop is known: alpha, and the subject's own colours.

Edge pixels are a mixture of subject and backdrop: C = alpha F + (1 - alpha) B in linear light, where F goes on from the
subject's inside. Source: Smith and Blinn 1996, "Blue Screen Matting"; F by its neighbours, as in Bayesian matting.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..filling import push_pull

BoolArray = NDArray[np.bool_]

_EDGE_WIDTHS, _MIN_EDGE_PIXELS = 0.004, 2
"""Reach of mixed pixels from the backdrop, in units of the picture's width: a lens's and a codec's blur."""
_CLIPPED = 0.05
"""Alpha below which a pixel is backdrop, and likewise subject: noise and compression."""
_LEAST_CONTRAST = 1e-5
"""Square of a difference of linear colours that says nothing of alpha."""
_LEAST_SHARE = np.float32(1e-3)
"""Of a window inside the subject, from which it says how the subject's colours go on."""
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
    there = backdrop.astype(np.uint8)
    reach = max(_MIN_EDGE_PIXELS, round(_EDGE_WIDTHS * picture.shape[1]))
    inside = cv2.dilate(there, _disc(reach)) == 0
    outside = cv2.erode(there, _disc(1), borderValue=1) > 0
    continued = _continued(picture, inside, reach)
    apart = continued - plate
    contrast = np.maximum((apart * apart).sum(axis=2), np.float32(_LEAST_CONTRAST))
    mixed = ((picture - plate) * apart).sum(axis=2) / contrast
    alpha = np.clip((mixed - _CLIPPED) / (1 - 2 * _CLIPPED), 0, 1).astype(np.float32)
    alpha[inside], alpha[outside] = 1, 0
    part = alpha[..., None]
    unmixed = (picture - (1 - part) * plate) / np.maximum(part, np.float32(_MIN_ALPHA))
    colours = np.where(part > 0, np.maximum(unmixed, 0), np.where(part < 1, continued, picture))
    return Subject(alpha, np.asarray(colours, np.float32))


def _continued(picture: FloatArray, inside: BoolArray, reach: int) -> FloatArray:
    """The colours inside going on around: the means of those near, or else of a growing surrounding."""
    weights = inside.astype(np.float32)
    sums, window = picture * weights[..., None], (4 * reach + 1,) * 2
    near = np.asarray(cv2.blur(weights, window), np.float32)[..., None]
    small = tuple(max(1, side // reach) for side in inside.shape[::-1])
    shrunk = np.asarray(cv2.resize(weights, small, interpolation=cv2.INTER_AREA), np.float32)
    means = cv2.resize(sums, small, interpolation=cv2.INTER_AREA) / np.maximum(shrunk, 1e-6)[..., None]
    far = cv2.resize(push_pull(np.asarray(means, np.float32), shrunk), inside.shape[::-1])
    return np.where(near > _LEAST_SHARE, cv2.blur(sums, window) / np.maximum(near, _LEAST_SHARE), far)


def _disc(radius: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)
