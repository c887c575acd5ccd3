"""What a matte alone shows that it cannot be one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SURE_SUBJECT = 0.9
"""Alpha from which a pixel is taken for the subject's."""
_ALL, _LEVEL = 0.995, 1 / 255
_MAX_LABEL = 8 / 255
"""Brightest pixel of a matte that was saved as numbers of objects."""
_INVERTED_BORDER = 0.95
"""White share of the border of a matte from which, with less in the middle, it is inverted."""


def problem_of(alpha: NDArray[np.float32]) -> str:
    """Why a matte (H, W) 0..1 is none: white all over, labels of objects, inverted; empty where it may be one."""
    if (alpha > _ALL).mean() > _ALL:
        return "white all over; white is subject, black is empty"
    if _LEVEL <= alpha.max() <= _MAX_LABEL:
        return f"nowhere brighter than {255 * alpha.max():.0f} of 255, like labels of objects; write white for them"
    border = np.concatenate([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
    height, width = alpha.shape
    middle = alpha[height // 4 : -(height // 4) or None, width // 4 : -(width // 4) or None]
    if (border > SURE_SUBJECT).mean() > _INVERTED_BORDER and middle.mean() < border.mean():
        return "white at all borders and not in the middle, so inverted; white is subject"
    return ""
