"""What each Gaussian is worth: how much pictures change without it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats, sigmoid

from ..backends import TrainingKernel

F64 = NDArray[np.float64]

_MOST_OPACITY = 0.99
"""Above, a logit says little of what a Gaussian covers."""


def utility(kernel: TrainingKernel, splats: Splats, cameras: Sequence[Camera], random: np.random.Generator) -> F64:
    """The squared error over the cameras' pictures that leaving out each Gaussian (N,) would make, to first order.

    Backward passes of random signs: the square of such a gradient is, in the mean, that of all pixels' derivatives
    (Hutchinson 1989).
    """
    total = np.zeros(len(splats))
    covered = np.minimum(sigmoid(splats.opacity_logits.astype(np.float64)), _MOST_OPACITY)
    for camera in cameras:
        shape = kernel.forward(splats, camera).rgb.shape
        signs = random.integers(0, 2, shape).astype(np.float32) * 2 - 1
        gradient = kernel.backward(splats, signs).host().opacity_logits.astype(np.float64)
        total += (gradient / (1 - covered)) ** 2
    return total
