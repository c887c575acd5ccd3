"""Adam over the stored values of the Gaussians under training, with rows that come and go and frozen values.

Only what is trained is here, so that nothing else has moments (docs/METHOD.md, "Optimiser-state reset"). Rejected:
torch.optim.Adam (its parameters have no rows that come and go).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import RowArray
from decogs.formats.splats import FloatArray, Splats, join_splats, take_splats

from ...settings.optimiser import LearningRates
from ..protocol import ATTRIBUTES, Drawable, Gradients, SplatGradients, gradients_like
from .stretch import limit_stretch

if TYPE_CHECKING:
    from .cpu_kernel import CpuKernel


def drawn_splats(drawn: Drawable) -> Splats:
    """The values of what is drawn; the kernel reads them where they are."""
    return drawn if isinstance(drawn, Splats) else drawn.splats


def room_for_gradients(drawn: Drawable) -> SplatGradients:
    """Room for the gradients of what is drawn; an optimiser has some, from step to step."""
    return drawn.gradients if isinstance(drawn, CpuOptimiser) else gradients_like(drawn_splats(drawn))


class CpuOptimiser:
    """The stored values under training, their Adam moments, and room for their gradients."""

    def __init__(
        self,
        splats: Splats,
        kernel: CpuKernel,
        *,
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
    ) -> None:
        self._kernel = kernel
        self._beta1, self._beta2, self._epsilon = beta1, beta2, epsilon
        self.splats = Splats(*(getattr(splats, name).copy() for name in ATTRIBUTES))
        self._first = _zeros_like(splats)
        self._second = _zeros_like(splats)
        self._steps = 0
        self._frozen: dict[str, tuple[NDArray[np.bool_], FloatArray]] = {}
        self.gradients = gradients_like(splats)

    def __len__(self) -> int:
        return len(self.splats)

    def copy(self) -> CpuOptimiser:
        other = CpuOptimiser(self.splats, self._kernel, beta1=self._beta1, beta2=self._beta2, epsilon=self._epsilon)
        other.copy_momentum(self, np.arange(len(self.splats)), np.arange(len(self.splats)))
        return other

    def step(
        self,
        gradients: Gradients,
        rates: LearningRates,
        *,
        max_stretch: float = 0.0,
        reach: FloatArray | None = None,
    ) -> None:
        self._steps += 1
        start = None if reach is None else self.splats.means.copy()
        host_gradients = gradients.host()
        # Where sizes are not trained, as in frames that only light changes, none can stretch.
        before = self.splats.log_scales.copy() if max_stretch and rates.log_scales else None
        for name, rate in self._moving(rates):
            self._kernel.adam(
                getattr(self.splats, name),
                getattr(host_gradients, name),
                getattr(self._first, name),
                getattr(self._second, name),
                rate=rate,
                step=self._steps,
                beta1=self._beta1,
                beta2=self._beta2,
                epsilon=self._epsilon,
            )
        if start is not None and reach is not None:
            self.splats.means[:] = start + reach[:, None] * (self.splats.means - start)
        for name, (frozen, values) in self._frozen.items():
            np.copyto(getattr(self.splats, name), values, where=frozen)
        if before is not None:
            limit_stretch(self.splats.log_scales, before, max_stretch)

    def _moving(self, rates: LearningRates) -> Iterator[tuple[str, float | FloatArray]]:
        """The attributes whose rate is not 0, and that rate: one for each number of a Gaussian's ``sh``."""
        for name in ATTRIBUTES:
            if name != "sh" and (rate := getattr(rates, name)):
                yield name, rate
        by_coefficient = [rates.sh_dc] + [rates.sh_rest] * (self.splats.sh.shape[1] - 1)
        if any(by_coefficient):
            yield "sh", np.repeat(np.array(by_coefficient, np.float32), 3)

    def put(self, rows: RowArray | None = None, **values: FloatArray) -> None:
        for name, new in values.items():
            getattr(self.splats, name)[slice(None) if rows is None else rows] = new

    def freeze(self, frozen: Mapping[str, NDArray[np.bool_]]) -> None:
        self._frozen |= {name: (mask, getattr(self.splats, name).copy()) for name, mask in frozen.items()}

    def gradient_size(self, name: str) -> FloatArray:
        seen = 1 - float(np.float32(self._beta2)) ** max(1, self._steps)
        second: FloatArray = getattr(self._second, name)
        return np.asarray(np.sqrt(second * np.float32(1 / seen)))

    def keep(self, rows: NDArray[np.bool_] | RowArray) -> None:
        self._replace(*(take_splats(each, rows) for each in (self.splats, self._first, self._second)))

    def append(self, added: Splats) -> None:
        mine, zeros = (self.splats, self._first, self._second), _zeros_like(added)
        self._replace(*(join_splats(*pair) for pair in zip(mine, (added, zeros, zeros), strict=True)))

    def copy_momentum(self, other: CpuOptimiser, rows: RowArray, theirs: RowArray) -> None:
        self._steps = other._steps
        for own, moments in ((self._first, other._first), (self._second, other._second)):
            for name in ATTRIBUTES:
                getattr(own, name)[rows] = getattr(moments, name)[theirs]

    def _replace(self, splats: Splats, first: Splats, second: Splats) -> None:
        self.splats, self._first, self._second = splats, first, second
        self._frozen, self.gradients = {}, gradients_like(splats)


def _zeros_like(splats: Splats) -> Splats:
    return Splats(*(np.zeros_like(getattr(splats, name)) for name in ATTRIBUTES))
