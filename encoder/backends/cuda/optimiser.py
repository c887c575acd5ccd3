"""Adam on the device: values, moments and gradients stay there, and a step waits for nothing.

Chosen: the formula of cpu/kernel/adam.h in one launch for all attributes together. Rejected: torch.optim.Adam (its
parameters have no rows that come and go).
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray
from decogs.formats.splats import FloatArray, Splats

from ...settings.optimiser import LearningRates
from ..protocol import ATTRIBUTES, Gradients
from .device import read_floats, upload
from .gradients import tensors_of
from .module import THREADS, Kernels

Tensors = dict[str, Tensor]

_EPSILON = 1e-15
"""As the native optimiser's."""


class _Trained(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("value", "gradient", "first", "second", "frozen", "kept")),
        ("columns", ctypes.c_int),
        ("few", ctypes.c_int),
        ("rate", ctypes.c_float),
        ("few_rate", ctypes.c_float),
    ]


class _AdamStep(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_float) for name in ("beta1", "beta2", "epsilon", "first_scale", "second_root", "longest")),
        ("sizes", ctypes.c_int),
    ]


class CudaOptimiser:
    """``Optimiser`` on a torch ``device``; ``values`` are its tensors by attribute."""

    def __init__(self, splats: Splats, kernels: Kernels, device: torch.device, *, beta1: float, beta2: float) -> None:
        self._kernels, self._device = kernels, device
        # As the native kernel rounds them; corrections from the same numbers keep the first step's size exact.
        self._beta1, self._beta2 = float(np.float32(beta1)), float(np.float32(beta2))
        self.values = _uploaded(splats, device)
        self._first, self._second = _zeros_like(self.values), _zeros_like(self.values)
        self._steps = 0
        self._frozen: dict[str, tuple[Tensor, Tensor]] = {}
        self._read: Splats | None = None

    def __len__(self) -> int:
        return len(self.values["means"])

    @property
    def splats(self) -> Splats:
        if self._read is None:
            self._read = Splats(*(read_floats(self.values[name]) for name in ATTRIBUTES))
            for array in vars(self._read).values():
                array.flags.writeable = False  # what somebody writes there would be lost
        return self._read

    def step(
        self,
        gradients: Gradients,
        rates: LearningRates,
        *,
        max_stretch: float = 0.0,
        reach: FloatArray | None = None,
    ) -> None:
        self._steps, self._read = self._steps + 1, None
        start = None if reach is None else self.values["means"].clone()
        if not len(self):
            return
        tensors = tensors_of(gradients, self._device)
        step = _AdamStep(
            self._beta1,
            self._beta2,
            _EPSILON,
            1 / (1 - self._beta1**self._steps),
            1 / math.sqrt(1 - self._beta2**self._steps),
            math.log(max_stretch) if max_stretch else -1.0,
            ATTRIBUTES.index("log_scales"),
        )
        blocks = -(-len(self) // THREADS), len(ATTRIBUTES)
        trained = [self._trained(name, tensors, rates) for name in ATTRIBUTES]
        self._kernels.launch("adam", blocks, *trained, len(self), step)
        if start is not None and reach is not None:
            means = self.values["means"]
            means.copy_(start + upload(reach, self._device)[:, None] * (means - start))

    def _trained(self, name: str, gradients: Tensors, rates: LearningRates) -> _Trained:
        """An attribute for the kernel, null where its rate is 0."""
        rate, few_rate = (rates.sh_rest, rates.sh_dc) if name == "sh" else (getattr(rates, name), 0.0)
        if not (rate or few_rate):
            return _Trained()
        pointers = [each[name].data_ptr() for each in (self.values, gradients, self._first, self._second)]
        frozen, kept = (each.data_ptr() for each in self._frozen[name]) if name in self._frozen else (None, None)
        columns = self.values[name][0].numel()
        return _Trained(*pointers, frozen, kept, columns, 3 if name == "sh" else 0, rate, few_rate)

    @torch.no_grad()
    def put(self, rows: RowArray | None = None, **values: FloatArray) -> None:
        self._read = None
        for name, new in values.items():
            if rows is None:
                self.values[name].copy_(upload(new, self._device))
            else:
                self.values[name].index_copy_(0, upload(rows, self._device), upload(new, self._device))

    def freeze(self, frozen: Mapping[str, NDArray[np.bool_]]) -> None:
        self._frozen |= {name: (upload(mask, self._device), self.values[name].clone()) for name, mask in frozen.items()}

    def gradient_size(self, name: str) -> FloatArray:
        seen = 1 - self._beta2 ** max(1, self._steps)
        return read_floats((self._second[name] / seen).sqrt())

    def keep(self, rows: NDArray[np.bool_] | RowArray) -> None:
        where = upload(np.flatnonzero(rows) if rows.dtype == np.bool_ else rows, self._device)
        self._replace(lambda mine, _: mine[where], self.values)

    def append(self, added: Splats) -> None:
        new = _uploaded(added, self._device)
        self._replace(lambda mine, more: torch.cat([mine, more]), new)

    def copy(self) -> CudaOptimiser:
        other = CudaOptimiser(self.splats, self._kernels, self._device, beta1=self._beta1, beta2=self._beta2)
        other._steps = self._steps
        other._first, other._second = ({n: t.clone() for n, t in each.items()} for each in (self._first, self._second))
        return other

    def copy_momentum(self, other: CudaOptimiser, rows: RowArray, theirs: RowArray) -> None:
        self._steps = other._steps
        to, of = upload(rows, self._device), upload(theirs, self._device)
        for mine, moments in ((self._first, other._first), (self._second, other._second)):
            for name in ATTRIBUTES:
                mine[name][to] = moments[name][of]

    def _replace(self, change: Callable[[Tensor, Tensor], Tensor], new: Tensors) -> None:
        """Changes the set of rows: values by ``new`` ones, moments by zeros of their shape."""
        zeros = _zeros_like(new)
        self.values, self._first, self._second = (
            {name: change(mine[name], other[name]) for name in ATTRIBUTES}
            for mine, other in ((self.values, new), (self._first, zeros), (self._second, zeros))
        )
        self._frozen, self._read = {}, None


def _uploaded(splats: Splats, device: torch.device) -> Tensors:
    return {name: upload(getattr(splats, name), device) for name in ATTRIBUTES}


def _zeros_like(values: Tensors) -> Tensors:
    return {name: torch.zeros_like(each) for name, each in values.items()}
