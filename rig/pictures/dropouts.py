"""Pictures that do not show their frame: a camera that dropped it, died, or was blinded by a flash.

Such a picture must not change the scene: its view is left out of masks, selection and loss until it shows something
again, and a frame in which no view is left repeats the one before. So a flash or a blackout of the whole rig is not
encoded.

Chosen: two signs that need no setting. A picture is *blank* when it is one colour all over up to noise, unlike
earlier ones of its camera; it is *frozen* when it repeats the camera's picture before it bit for bit while most
cameras show a change: no sensor does that, but recorders fill a gap so. A lamp that is switched on changes all pixels,
and is to be seen. A picture that cannot be had at all is lost without a sign (``RigFrame.lost``).
"""

from __future__ import annotations

import math

import numpy as np

from decogs.formats.splats import FloatArray

BLACK, BLANK, FROZEN = "black", "of a single colour", "a repeat of the previous one"
"""Why a picture is left out."""

_MAX_BLANK_SPREAD = 10 / 255
"""Noise of three levels, more than any sensor's in the dark, keeps 98 % of a blank picture's pixels inside this."""
_SAMPLED_PIXELS = 2000
"""Pixels, evenly spread, that suffice for the decision."""


def blankness(picture: FloatArray) -> str:
    """BLACK or BLANK when the picture (3, H, W) shows nothing, empty when it shows something."""
    step = max(1, math.isqrt(picture[0].size // _SAMPLED_PIXELS))
    low, high = np.percentile(picture[:, ::step, ::step].reshape(3, -1), [1, 99], axis=1)
    if (high - low).max() > _MAX_BLANK_SPREAD:
        return ""
    return BLACK if high.max() <= _MAX_BLANK_SPREAD else BLANK


def repeats(picture: FloatArray, before: FloatArray) -> bool:
    """Whether the picture is the one before it, bit for bit."""
    return np.array_equal(picture[:, ::16], before[:, ::16]) and np.array_equal(picture, before)
