"""Gradients that stay on the device."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.formats.cameras import Camera

from ..protocol import ATTRIBUTES, Gradients, SplatGradients
from .device import read, read_floats, upload

NAMES = (*ATTRIBUTES, "view")


class DeviceGradients:
    """``Gradients`` as tensors by attribute, and of the projected centres as ``view``."""

    def __init__(self, tensors: dict[str, Tensor]) -> None:
        self.tensors = tensors

    def host(self) -> SplatGradients:
        values = [self.tensors[name] for name in NAMES]
        block = read_floats(torch.cat([each.flatten() for each in values]))  # they travel together
        parts = np.split(block, np.cumsum([each.numel() for each in values])[:-1])
        return SplatGradients(*(part.reshape(each.shape) for part, each in zip(parts, values, strict=True)))

    def put_into(self, out: SplatGradients) -> SplatGradients:
        """The same in the host's arrays ``out``."""
        found = self.host()
        for name in NAMES:
            getattr(out, name)[:] = getattr(found, name)
        return out


def tensors_of(gradients: Gradients, device: torch.device) -> dict[str, Tensor]:
    """Gradients as tensors: where they are, or uploaded."""
    if isinstance(gradients, DeviceGradients):
        return gradients.tensors
    found = gradients.host()
    return {name: upload(getattr(found, name), device) for name in NAMES}


class CudaViewGradients:
    """``ViewGradients`` on a torch ``device``."""

    def __init__(self, count: int, device: torch.device) -> None:
        self._device = device
        self._sum = torch.zeros(count, dtype=torch.float64, device=device)
        self._views = torch.zeros(count, dtype=torch.int64, device=device)

    def add(self, gradients: Gradients, camera: Camera, emphasis: float = 1.0) -> None:
        view = tensors_of(gradients, self._device)["view"] / emphasis
        self._sum += view.double() * (max(camera.width, camera.height) / 2)
        self._views += view > 0

    def mean(self) -> NDArray[np.float64]:
        return read(self._sum / self._views.clamp(min=1))
