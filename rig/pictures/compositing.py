"""A subject without its background: pictures composited over one flat colour, over which the encoder renders too.

So whatever is transparent shows that colour, in every view and frame alike: a Gaussian where nothing is misses it, and
a hole in the subject shows it. No other loss is needed. The colour is far from all of the subject's.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from decogs.formats.colours.srgb import BLACK, Colour
from decogs.formats.splats import FloatArray

_SUBJECT_ALPHA = 0.9
"""Opacity from which a pixel has the subject's own colour."""
_NEAREST_PERCENT = 0.5
"""Share of the subject's pixels that may be nearer to the background's colour than what counts."""
_MAX_SAMPLES = 20_000


def background_for(pictures: Sequence[FloatArray], alphas: Sequence[FloatArray]) -> Colour:
    """The saturated colour that is farthest from the subject's in ``pictures`` (3, H, W) with ``alphas`` (H, W)."""
    each = max(1, _MAX_SAMPLES // len(pictures))
    opaque = (picture[:, alpha >= _SUBJECT_ALPHA] for picture, alpha in zip(pictures, alphas, strict=True))
    subject = np.concatenate([colours[:, :: max(1, colours.shape[1] // each)] for colours in opaque], axis=1).T
    if not len(subject):
        return BLACK
    corners = np.array(list(product((0, 1), repeat=3)), np.float32)
    distances = [np.percentile(np.abs(subject - corner).max(axis=1), _NEAREST_PERCENT) for corner in corners]
    red, green, blue = corners[int(np.argmax(distances))].tolist()
    return red, green, blue


def over(picture: FloatArray, alpha: FloatArray, background: Colour, plate: FloatArray | None = None) -> FloatArray:
    """The subject of a picture (3, H, W) over ``background``.

    At its edges a picture mixes the subject's colour with what was behind it, the ``plate`` (3, H, W). Where that is
    known it is exchanged, else it stays in the mix.
    """
    flat = np.asarray(background, np.float32)[:, None, None]
    if plate is not None:
        return np.ascontiguousarray(np.clip(picture + (1 - alpha) * (flat - plate), 0, 1))
    return np.ascontiguousarray(alpha * picture + (1 - alpha) * flat)
