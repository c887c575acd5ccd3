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
    continued = push_pull(picture, inside.astype(np.float32))
    apart = continued - plate
    contrast = np.maximum((apart * apart).sum(axis=2), np.float32(_LEAST_CONTRAST))
    mixed = ((picture - plate) * apart).sum(axis=2) / contrast
    alpha = np.clip((mixed - _CLIPPED) / (1 - 2 * _CLIPPED), 0, 1).astype(np.float32)
    alpha[inside], alpha[outside] = 1, 0
    part = alpha[..., None]
    unmixed = (picture - (1 - part) * plate) / np.maximum(part, np.float32(_MIN_ALPHA))
    colours = np.where(part > 0, np.maximum(unmixed, 0), np.where(part < 1, continued, picture))
    return Subject(alpha, np.asarray(colours, np.float32))


def _disc(radius: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2), np.uint8)
