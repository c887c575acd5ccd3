"""Display-referred colours: the sRGB curve (IEC 61966-2-1), without clipping, and their brightness.

Results have the type of what is given.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", np.float32, np.float64)

Colour = tuple[float, float, float]
"""Red, green and blue, display-referred, 0 to 1."""
BLACK: Colour = (0.0, 0.0, 0.0)

LUMA = np.array([0.299, 0.587, 0.114])
"""Shares of red, green and blue in a picture's brightness (Rec. 601)."""


def linear_from_srgb(coded: NDArray[F]) -> NDArray[F]:
    """Linear light of coded values of at least 0."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: NDArray[F]) -> NDArray[F]:
    """Coded values of linear light of at least 0."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * np.power(linear, 1 / 2.4) - 0.055)
