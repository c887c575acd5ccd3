"""View gradients gathered in the host's memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera

from ..protocol import Gradients


class CpuViewGradients:
    """``ViewGradients`` as numpy arrays."""

    def __init__(self, count: int) -> None:
        self._sum = np.zeros(count, np.float64)
        self._views = np.zeros(count, np.int64)

    def add(self, gradients: Gradients, camera: Camera, emphasis: float = 1.0) -> None:
        view = gradients.host().view / np.float32(emphasis)
        self._sum += view.astype(np.float64) * (max(camera.width, camera.height) / 2)
        self._views += view > 0

    def mean(self) -> NDArray[np.float64]:
        return self._sum / np.maximum(self._views, 1)
