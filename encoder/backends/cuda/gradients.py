"""Gradients that stay on the device."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.formats.cameras import Camera

from ..protocol import ATTRIBUTES, Gradients, SplatGradients
from .device import read, read_floats, upload
from .module import THREADS, Kernels

NAMES = (*ATTRIBUTES, "view")


class DeviceGradients:
    """``Gradients`` as tensors by attribute, and of the projected centres as ``view``: parts of one ``block``."""

    def __init__(self, block: Tensor, shapes: Sequence[Sequence[int]]) -> None:
        self._block, self._sizes = block, [math.prod(shape) for shape in shapes]
        parts = zip(NAMES, torch.split(block, self._sizes), shapes, strict=True)
        self.tensors = {name: part.view(*shape) for name, part, shape in parts}

    @classmethod
    def room_for(cls, stored: Sequence[Tensor]) -> DeviceGradients:
        """Room for the gradients of stored values, in the order of ATTRIBUTES."""
        shapes = [*(tensor.shape for tensor in stored), stored[0].shape[:1]]
        return cls(torch.empty(sum(map(math.prod, shapes)), device=stored[0].device), shapes)

    def host(self) -> SplatGradients:
        parts = np.split(read_floats(self._block), np.cumsum(self._sizes)[:-1])
        return SplatGradients(*(part.reshape(self.tensors[n].shape) for n, part in zip(NAMES, parts, strict=True)))

    def put_into(self, out: SplatGradients) -> SplatGradients:
        """The same in the host's arrays ``out``."""
        arrays = self.host()
        for name in NAMES:
            getattr(out, name)[:] = getattr(arrays, name)
        return out


def tensors_of(gradients: Gradients, device: torch.device) -> dict[str, Tensor]:
    """Gradients as tensors: where they are, or uploaded."""
    if isinstance(gradients, DeviceGradients):
        return gradients.tensors
    arrays = gradients.host()
    return {name: upload(getattr(arrays, name), device) for name in NAMES}


class CudaViewGradients:
    """``ViewGradients`` on a torch ``device``."""

    def __init__(self, count: int, kernels: Kernels, device: torch.device) -> None:
        self._kernels, self._device = kernels, device
        self._sum = torch.zeros(count, dtype=torch.float64, device=device)
        self._views = torch.zeros(count, dtype=torch.int64, device=device)

    def add(self, gradients: Gradients, camera: Camera, emphasis: float = 1.0) -> None:
        view = tensors_of(gradients, self._device)["view"]
        half_size = ctypes.c_double(max(camera.width, camera.height) / 2)
        if len(view):
            arguments = (view, len(view), float(emphasis), half_size, self._sum, self._views)
            self._kernels.launch("add_view", (-(-len(view) // THREADS),), *arguments)

    def mean(self) -> NDArray[np.float64]:
        return read(self._sum / self._views.clamp(min=1))
