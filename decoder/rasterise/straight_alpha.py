"""A subject's picture without anything behind it: its own colours, and what it covers of each pixel.

Its rendering over black holds c, the sum of its Gaussians' colours by their weights, and a, the sum of the weights.
Its own colour, c / a, is the *straight* one: a times it, plus (1 - a) times any background, is the picture over that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

if TYPE_CHECKING:
    from . import Rendering


def straight_colours(over_black: FloatArray, alpha: FloatArray) -> FloatArray:
    """The subject's own colours (H, W, 3), display-referred, of its picture over black; black where ``alpha`` is 0."""
    covered = alpha[..., None]
    return np.divide(over_black, covered, out=np.zeros_like(over_black), where=covered > 0)


def straight_picture(seen: Rendering) -> NDArray[np.float32]:
    """Straight colours and alpha (H, W, 4) of a subject rendered over black."""
    return np.concatenate([straight_colours(seen.image, seen.alpha), seen.alpha[..., None]], axis=-1)
