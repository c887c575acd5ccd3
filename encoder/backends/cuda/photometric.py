"""L1 and SSIM of pictures on a device, through the kernels; cpu/kernel/loss.h is their readable twin."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from ..protocol import LossValue
from .device import read
from .module import Kernels

_TILE_PIXELS = 16


class _Compared(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("image", "target", "l1_weight", "focus", "wanted")),
        ("l1_scale", ctypes.c_float),
        ("ssim_scale", ctypes.c_float),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
    ]


class DeviceLoss:
    """The loss of pictures; it keeps room for those of the last size."""

    def __init__(self, kernels: Kernels, device: torch.device) -> None:
        self._kernels, self._device = kernels, device
        self._maps = torch.empty(0, device=device)

    def __call__(
        self,
        image: Tensor,
        given: Sequence[Tensor | None],
        wanted: Tensor | None,
        l1_scale: float,
        ssim_scale: float,
    ) -> tuple[LossValue, Tensor]:
        """The loss of ``image`` (3, H, W) against target, weight of L1 and focus, all on the device.

        Summed over the tiles ``wanted``, or all; with its gradient (3, H, W), which means nothing elsewhere.
        """
        _, height, width = image.shape
        blocks = (-(-width // _TILE_PIXELS), -(-height // _TILE_PIXELS), 3)
        if self._maps.shape[2:] != image.shape[1:]:
            self._maps = torch.empty((3, 3, height, width), device=self._device)
        pointers = [None if tensor is None else tensor.data_ptr() for tensor in (image, *given, wanted)]
        compared = _Compared(*pointers, l1_scale, ssim_scale, width, height)
        sums = torch.empty((2, blocks[0] * blocks[1] * 3), device=self._device)
        if ssim_scale:
            self._kernels.launch("compare_windows", blocks, compared, self._maps, sums[1])
        else:
            sums[1].zero_()
        gradient = torch.empty_like(image)
        self._kernels.launch("differentiate", blocks, compared, self._maps, gradient, sums[0])
        totals = torch.empty(2, dtype=torch.float64, device=self._device)
        self._kernels.launch("sum_losses", (2,), sums, sums.shape[1], totals)
        return LossValue(l1_scale, ssim_scale, lambda: read(totals).tolist()), gradient
