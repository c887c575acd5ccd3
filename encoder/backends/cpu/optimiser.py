"""Adam over the stored values of a scene, with rows that come, go, or must not move.

Chosen: one set of moments per attribute, stepped natively on the given rows only, so that a row that is not stepped
keeps value and moments bit for bit (the method's "Adam reset" is then a matter of starting without moments).
Rejected: torch.optim.Adam (steps every row, and its sparse variant has no row sets that change).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray, Splats, join_splats, take_splats

from ...registry import Registry, described, guarded
from ...settings.optimiser import LearningRates
from .native import SplatGradients, TrainingKernel

if TYPE_CHECKING:
    from typing_extensions import Self

ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


class Optimiser(Protocol):
    """The stored values under training, stepped in place. Attributes are those of ``Splats``, named in ATTRIBUTES."""

    @property
    def splats(self) -> Splats:
        """The values, N rows."""
        ...

    def step(self, gradients: SplatGradients, rates: LearningRates, *, rows: NDArray[np.int64] | None = None) -> None:
        """One step of every attribute whose rate is not 0, on ``rows`` or on all; other rows keep every bit."""
        ...

    def hold(self, held: Mapping[str, NDArray[np.bool_]]) -> None:
        """From now on these numbers of each attribute keep their values, until rows come or go."""
        ...

    def gradient_size(self, name: str) -> FloatArray:
        """Size of an attribute's gradients so far, shaped like it: the loss's sensitivity to a change."""
        ...

    def keep(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> None:
        """Drops every other row, or puts rows into a new order."""
        ...

    def append(self, added: Splats) -> None:
        """Adds rows without momentum."""
        ...

    def copied(self) -> Self:
        """The same values and momentum, stepped apart from now on; nothing is held."""
        ...

    def remember(self, other: Any, rows: NDArray[np.int64], theirs: NDArray[np.int64]) -> None:
        """Takes over the momentum of an ``other`` of its kind: of its rows ``theirs`` for ``rows``."""
        ...


class NewOptimiser(Protocol):
    """Makes an optimiser of a copy of ``splats``; ``kernel`` steps natively."""

    def __call__(
        self, splats: Splats, kernel: TrainingKernel, /, *, beta1: float = 0.9, beta2: float = 0.999
    ) -> Optimiser: ...


class Adam:
    """The stored values under training and their Adam moments; ``splats`` is stepped in place."""

    def __init__(
        self,
        splats: Splats,
        kernel: TrainingKernel,
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
        self._held: dict[str, tuple[NDArray[np.bool_], FloatArray]] = {}

    def copied(self) -> Adam:
        """The same values and momentum, stepped apart from now on; nothing is held."""
        other = Adam(self.splats, self._kernel, beta1=self._beta1, beta2=self._beta2, epsilon=self._epsilon)
        other.remember(self, np.arange(len(self.splats)), np.arange(len(self.splats)))
        return other

    def step(self, gradients: SplatGradients, rates: LearningRates, *, rows: NDArray[np.int64] | None = None) -> None:
        """One step of every attribute whose rate is not 0, on ``rows`` or on all."""
        self._steps += 1
        for name, rate in self._moving(rates):
            self._kernel.adam(
                getattr(self.splats, name),
                getattr(gradients, name),
                getattr(self._first, name),
                getattr(self._second, name),
                rate=rate,
                step=self._steps,
                beta1=self._beta1,
                beta2=self._beta2,
                epsilon=self._epsilon,
                rows=rows,
            )
        for name, (held, values) in self._held.items():
            np.copyto(getattr(self.splats, name), values, where=held)

    def _moving(self, rates: LearningRates) -> Iterator[tuple[str, float | FloatArray]]:
        """The attributes whose rate is not 0, and that rate: one for each number of a Gaussian's ``sh``."""
        for name in ATTRIBUTES:
            if name != "sh" and (rate := getattr(rates, name)):
                yield name, rate
        by_coefficient = [rates.sh_dc] + [rates.sh_rest] * (self.splats.sh.shape[1] - 1)
        if any(by_coefficient):
            yield "sh", np.repeat(np.array(by_coefficient, np.float32), 3)

    def hold(self, held: Mapping[str, NDArray[np.bool_]]) -> None:
        """From now on these numbers of each attribute keep their values, until rows come or go."""
        self._held |= {name: (mask, getattr(self.splats, name).copy()) for name, mask in held.items()}

    def gradient_size(self, name: str) -> FloatArray:
        """Root mean square of an attribute's gradients so far, shaped like it, the recent ones weighing most.

        Before the first step, 0.
        """
        seen = 1 - float(np.float32(self._beta2)) ** max(1, self._steps)
        second: FloatArray = getattr(self._second, name)
        return np.asarray(np.sqrt(second * np.float32(1 / seen)))

    def keep(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> None:
        """Drops every other row, or puts rows into a new order."""
        self.splats, self._held = take_splats(self.splats, rows), {}
        self._first, self._second = take_splats(self._first, rows), take_splats(self._second, rows)

    def remember(self, other: Adam, rows: NDArray[np.int64], theirs: NDArray[np.int64]) -> None:
        """Takes over the momentum of another optimiser's rows ``theirs`` for ``rows``, and its count of steps."""
        self._steps = other._steps
        for own, moments in ((self._first, other._first), (self._second, other._second)):
            for name in ATTRIBUTES:
                getattr(own, name)[rows] = getattr(moments, name)[theirs]

    def append(self, added: Splats) -> None:
        """Adds rows without momentum."""
        self.splats, self._held = join_splats(self.splats, added), {}
        self._first = join_splats(self._first, _zeros_like(added))
        self._second = join_splats(self._second, _zeros_like(added))


def _zeros_like(splats: Splats) -> Splats:
    return Splats(*(np.zeros_like(getattr(splats, name)) for name in ATTRIBUTES))


def _wrong_optimiser(made: object, *given: object, **named: object) -> str:
    wanted = [name for name in vars(Optimiser) if not name.startswith("_")]
    missing = [name for name in wanted if not hasattr(made, name)]
    return f"{described(made)}, an optimiser without `{missing[0]}`" if missing else ""


OPTIMISERS: Registry[NewOptimiser] = Registry(
    "optimiser", "decogs.optimisers", {"adam": Adam}, guarded(_wrong_optimiser)
)
