"""Adam on the device: values, moments and gradients stay there, and a step waits for nothing.

Chosen: the formula of kernel/adam.h in a few launches for all attributes together. Rejected: gsplat's ``SelectiveAdam``
(no bias correction); torch.optim.Adam (its parameters have no rows that come and go).
"""

from __future__ import annotations

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

Tensors = dict[str, Tensor]


class CudaOptimiser:
    """``Optimiser`` on a torch ``device``; ``values`` are its tensors by attribute."""

    def __init__(self, splats: Splats, device: torch.device, *, beta1: float, beta2: float) -> None:
        self._device = device
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

    @torch.no_grad()
    def step(
        self,
        gradients: Gradients,
        rates: LearningRates,
        *,
        max_stretch: float = 0.0,
    ) -> None:
        self._steps, self._read = self._steps + 1, None
        before = self.values["log_scales"].clone() if max_stretch and rates.log_scales else None
        found, rate_of = tensors_of(gradients, self._device), _rates_by_part(rates)
        of = [[_part(each, name) for name in rate_of] for each in (self.values, self._first, self._second, found)]
        self._adam(of[0], of[1], of[2], of[3], [*rate_of.values()])
        for name, (frozen, values) in self._frozen.items():
            self.values[name].copy_(torch.where(frozen, values, self.values[name]))
        if before is not None:
            limit_stretch(self.values["log_scales"], before, max_stretch)

    def _adam(
        self, values: list[Tensor], first: list[Tensor], second: list[Tensor], by: list[Tensor], rates: list[float]
    ) -> None:
        """Kingma 2015, algorithm 1, in place on values, first and second moments, for gradients ``by``."""
        if not rates:
            return
        torch._foreach_mul_(first, self._beta1)
        torch._foreach_add_(first, by, alpha=1 - self._beta1)
        torch._foreach_mul_(second, self._beta2)
        torch._foreach_addcmul_(second, by, by, value=1 - self._beta2)
        root = torch._foreach_sqrt(second)
        torch._foreach_mul_(root, 1 / math.sqrt(1 - self._beta2**self._steps))
        torch._foreach_add_(root, _EPSILON)
        torch._foreach_addcdiv_(values, first, root, [-rate / (1 - self._beta1**self._steps) for rate in rates])

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
        other = CudaOptimiser(self.splats, self._device, beta1=self._beta1, beta2=self._beta2)
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


_EPSILON = 1e-15
"""As the native optimiser's."""


def _rates_by_part(rates: LearningRates) -> dict[str, float]:
    """The attributes whose rate is not 0, and that rate; ``sh`` in two parts, which have two."""
    named = {name: getattr(rates, name) for name in ATTRIBUTES if name != "sh" and getattr(rates, name)}
    if rates.sh_dc or rates.sh_rest:
        named |= {"sh_dc": rates.sh_dc, "sh_rest": rates.sh_rest}
    return named


def _part(values: Tensors, name: str) -> Tensor:
    if name in ("sh_dc", "sh_rest"):
        return values["sh"][:, :1] if name == "sh_dc" else values["sh"][:, 1:]
    return values[name]


def stretches(log_scales: Tensor) -> Tensor:
    """Logarithm (N,) of the largest over the middle size of every Gaussian; ``log_scales`` (N, 3)."""
    ordered = log_scales.sort(dim=1).values
    return ordered[:, 2] - ordered[:, 1]


def limit_stretch(log_scales: Tensor, before: Tensor, max_stretch: float) -> None:
    """``cpu.stretch.limit_stretch`` of all rows: which ones are too long, the host need not know."""
    allowed = stretches(before).clamp(min=math.log(max_stretch))
    excess = (stretches(log_scales) - allowed).clamp(min=0)
    log_scales.scatter_add_(1, log_scales.argmax(dim=1, keepdim=True), -excess[:, None])


def _uploaded(splats: Splats, device: torch.device) -> Tensors:
    return {name: upload(getattr(splats, name), device) for name in ATTRIBUTES}


def _zeros_like(values: Tensors) -> Tensors:
    return {name: torch.zeros_like(each) for name, each in values.items()}
