"""A limit on how long and thin training may make a Gaussian.

A needle along the line of sight of one camera costs that camera nothing and crosses the pictures of the others. In
later frames, training stretches a few of the moving Gaussians a little each time, and nothing shortens them again.
Chosen: after each step, a Gaussian's largest size is at most ``max_stretch`` times its middle one. Discs, which
surfaces are made of, are not touched. One that is longer already cannot grow longer. Rejected: a penalty in the loss
(it needs a weight, and all Gaussians pay); a limit on size (needles are thin, not large). Figures: DESIGN.md.
"""

from __future__ import annotations

import math

import numpy as np

from decogs.formats.splats import FloatArray


def stretches(log_scales: FloatArray) -> FloatArray:
    """Logarithm (N,) of the largest over the middle size of every Gaussian; ``log_scales`` (N, 3)."""
    x, y, z = log_scales.T
    low, high = np.minimum(x, y), np.maximum(x, y)
    return np.asarray(np.maximum(high, z) - np.maximum(low, np.minimum(high, z)))


def limit_stretch(log_scales: FloatArray, before: FloatArray, max_stretch: float) -> None:
    """Shortens in place what is longer than ``max_stretch`` times its middle size and longer than ``before``.

    ``log_scales`` (N, 3), and what they were ``before``.
    """
    limit, now = np.float32(math.log(max_stretch)), stretches(log_scales)
    rows = np.flatnonzero(now > limit)  # few
    excess = np.maximum(now[rows] - np.maximum(stretches(before[rows]), limit), 0)
    log_scales[rows, log_scales[rows].argmax(axis=1)] -= excess
