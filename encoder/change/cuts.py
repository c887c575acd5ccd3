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

_MAX_CUT_CORRELATION = 0.25
"""Correlation, median over the views, below which two frames show different scenes."""
_MIN_EDGE_CONTRAST = 0.2
"""Least root mean square of the edges, in units of the contrast around them, of a picture that shows a scene: pictures
have .4 to .8, noise of three levels has less than .2."""
_NOISE_CONTRAST = np.float32(4 / 255)
"""Contrast of noise and rounding, 0 to 1, added to that around a pixel."""
_SHRUNK_WIDTH_PIXELS = 320
"""Least width of a shrunk picture: more would cost seconds a frame where light changes all of large pictures."""
_MIN_BLUR_PIXELS, _BLUR_WIDTHS = 1.5, 0.01
"""Deviation of the blur that removes wide structures: pixels at least, and a share of the shrunk picture's width."""


def shows_another_scene(pictures: Sequence[FloatArray], before: Sequence[FloatArray]) -> bool:
    """Whether pictures (3, H, W), colours 0 to 1, share no edges with those of the same views ``before``."""
    edges = [(_edges(now), _edges(old)) for now, old in zip(pictures, before, strict=True)]
    if not edges:
        return False
    contrast = float(np.median([np.sqrt(np.square(now).mean()) for now, _ in edges]))
    correlation = float(np.median([_correlation(*pair) for pair in edges]))
    return contrast > _MIN_EDGE_CONTRAST and correlation < _MAX_CUT_CORRELATION


def _edges(picture: FloatArray) -> FloatArray:
    """The picture, shrunk, grey, high-pass filtered, in units of its contrast: about 1 at an edge, 0 on a flat area."""
    factor = max(1, picture.shape[2] // _SHRUNK_WIDTH_PIXELS)
    grey = np.clip(picture, 0, 1).mean(axis=0)
    if factor > 1:
        grey = cv2.resize(grey, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(grey, (0, 0), 1.0)
    sigma = max(_MIN_BLUR_PIXELS, _BLUR_WIDTHS * grey.shape[1])
    high_pass = grey - cv2.GaussianBlur(grey, (0, 0), sigma)
    contrast = np.sqrt(cv2.GaussianBlur(np.square(high_pass), (0, 0), 2 * sigma))
    return np.asarray(high_pass / (contrast + _NOISE_CONTRAST), np.float32)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    norms = float(np.sqrt(np.square(one).sum(dtype=np.float64) * np.square(other).sum(dtype=np.float64)))
    return float((one * other).sum(dtype=np.float64)) / norms if norms else 1.0
