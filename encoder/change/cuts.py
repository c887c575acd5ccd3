"""Cuts: from one frame to the next the cameras show another scene, and nothing of the former one is left to follow.

A flash or a lamp changes nearly all pixels as well, but edges stay where they are. So pictures are compared without
their light: shrunk to some 320 pixels across, grey, high-pass filtered, in units of the contrast around each pixel.
Correlations of the two, on rigs of 336x252 to 1352x1014: -.06 to .1 between different scenes; .57 to 1, the median over
the views, in one scene whatever moves in it (.57: `panoptic_basketball` after two seconds); .97 to 1 where its light
becomes ten times fainter or four times stronger.

Rejected: the share of changed pixels alone (a lamp changes them all), and training on from the scene before, which ends
6 to 8 dB lower (DESIGN.md, "What happened (3)").
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from decogs.formats.splats import FloatArray

_MIN_SAME_CORRELATION = 0.25
"""Correlation, median over the views, from which on two frames show the same scene."""
_MIN_EDGE_CONTRAST = 0.2
"""Least root mean square of a picture's edges, in units of the contrast around them, in which there is a scene to
train: pictures have .4 to .8, noise of three levels has less than .2."""
_NOISE_CONTRAST = np.float32(4 / 255)
"""Contrast that counts as much as noise and rounding."""
_SHRUNK_WIDTH_PIXELS = 320
"""Least width of a shrunk picture: more would cost seconds a frame where light changes all of large pictures."""
_MIN_BLUR_PIXELS, _BLUR_PER_WIDTH = 1.5, 0.01
"""Deviation of the blur that removes wide structures: pixels at least, and a share of the shrunk picture's width."""


def shows_another_scene(pictures: Sequence[FloatArray], before: Sequence[FloatArray]) -> bool:
    """Whether pictures (3, H, W), colours 0 to 1, share no edges with those of the same views ``before``."""
    edges = [(_edges(now), _edges(was)) for now, was in zip(pictures, before, strict=True)]
    if not edges:
        return False
    contrast = float(np.median([np.sqrt(np.square(now).mean()) for now, _ in edges]))
    correlation = float(np.median([_correlation(*pair) for pair in edges]))
    return contrast > _MIN_EDGE_CONTRAST and correlation < _MIN_SAME_CORRELATION


def _edges(picture: FloatArray) -> FloatArray:
    """What is left of a picture without its light, shrunk: about 1 at an edge, 0 where nothing is to be seen."""
    factor = max(1, picture.shape[2] // _SHRUNK_WIDTH_PIXELS)
    grey = np.clip(picture, 0, 1).mean(axis=0)
    if factor > 1:
        grey = cv2.resize(grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(grey, (0, 0), 1.0)
    wide = max(_MIN_BLUR_PIXELS, _BLUR_PER_WIDTH * grey.shape[1])
    narrow = grey - cv2.GaussianBlur(grey, (0, 0), wide)
    contrast = np.sqrt(cv2.GaussianBlur(np.square(narrow), (0, 0), 2 * wide))
    return np.asarray(narrow / (contrast + _NOISE_CONTRAST), np.float32)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    both = float(np.sqrt(np.square(one).sum(dtype=np.float64) * np.square(other).sum(dtype=np.float64)))
    return float((one * other).sum(dtype=np.float64)) / both if both else 1.0
