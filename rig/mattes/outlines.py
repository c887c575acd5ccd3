"""Alpha along outlines that follows the picture's edges, not only each pixel's own colour.

Within 3 x 3 pixels alpha is linear in colour, as far as a first guess agrees: sharp luma tells where blurred chroma
does not. Sources: Levin, Lischinski and Weiss 2008, "A Closed-Form Solution to Natural Image Matting"; He, Sun and
Tang 2010, "Fast Matting Using Large Kernel Matting Laplacian Matrices": the matrix is never formed.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

_TRUST = 0.3
"""Weight of the guess, in units of one window's departure from a linear alpha."""
_NOISE = 3e-4 / 9
"""Variance of colours that is no edge."""
_STEPS = 6
"""Of conjugate gradients; those that follow move alpha by .003 on average."""


def fitted(picture: FloatArray, guess: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Alpha (H, W), its ``guess`` but where it is ``free`` to move; the picture (H, W, 3) in linear light."""
    alpha: FloatArray = guess.copy()
    if not free.any():
        return alpha
    box = _around(free)
    loose = free[box].astype(np.float32)
    windows = _windows(picture[box], free[box])
    rest = -loose * windows.departure(guess[box])
    step, square = rest, float((rest * rest).sum())
    for _ in range(_STEPS):
        if square < 1e-9:
            break
        pull = loose * (windows.departure(step) + np.float32(_TRUST) * step)
        length = np.float32(square / float((step * pull).sum()))
        alpha[box] += length * step
        rest = rest - length * pull
        before, square = square, float((rest * rest).sum())
        step = rest + np.float32(square / before) * step
    return alpha


def _around(free: NDArray[np.bool_]) -> tuple[slice, slice]:
    """The rectangle of pixels that share a window with a free one."""
    rows, columns = (np.flatnonzero(free.any(axis=axis)) for axis in (1, 0))
    return slice(max(0, rows[0] - 2), rows[-1] + 3), slice(max(0, columns[0] - 2), columns[-1] + 3)


@dataclass(frozen=True)
class _Windows:
    """Of 3 x 3 pixels each, where ``used`` (H, W) is 1: ``means`` (H, W, 3) of the colours, and inverse covariances."""

    colours: FloatArray
    used: FloatArray
    means: FloatArray
    inverses: FloatArray

    def departure(self, alpha: FloatArray) -> FloatArray:
        """Half the gradient (H, W) of the squared distance of alpha from what is linear in colour: L alpha."""
        mean = _sums(alpha) / 9
        products = _sums(self.colours * alpha[..., None]) / 9 - self.means * mean[..., None]
        slopes = np.einsum("hwcd,hwd->hwc", self.inverses, products)
        offsets = self.used * mean - (slopes * self.means).sum(axis=2)
        linear = (_sums(slopes) * self.colours).sum(axis=2) + _sums(offsets)
        return np.asarray(_sums(self.used) * alpha - linear, np.float32)


def _windows(colours: FloatArray, free: NDArray[np.bool_]) -> _Windows:
    """The windows inside the picture that hold a free pixel."""
    used = np.asarray(_sums(np.asarray(free, np.float32)) > 0)
    used[[0, -1]] = used[:, [0, -1]] = False
    means = np.asarray(_sums(colours) / 9, np.float32)
    pairs = (colours[..., :, None] * colours[..., None, :]).reshape(*used.shape, 9)
    covariances = (_sums(pairs) / 9).reshape(*used.shape, 3, 3)[used]
    covariances += np.float32(_NOISE) * np.eye(3, dtype=np.float32) - means[used][:, :, None] * means[used][:, None, :]
    inverses = np.zeros((*used.shape, 3, 3), np.float32)
    inverses[used] = np.linalg.inv(covariances)
    return _Windows(colours, used.astype(np.float32), means, inverses)


def _sums(values: FloatArray) -> FloatArray:
    """Over 3 x 3 pixels, of values (H, W) or (H, W, C)."""
    ones = np.ones(3, np.float32)
    return np.asarray(cv2.sepFilter2D(values, cv2.CV_32F, ones, ones, borderType=cv2.BORDER_CONSTANT))
