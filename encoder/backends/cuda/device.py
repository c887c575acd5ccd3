"""What travels between the host and a torch device.

`read` is the only way back: it waits until the device has done everything asked of it so far.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.formats.splats import FloatArray

S = TypeVar("S")
T = TypeVar("T")


def on_host(like: Tensor) -> Tensor:
    """Room in the host's memory, of pages that a device reads and writes by itself, for a tensor."""
    return torch.empty(like.shape, dtype=like.dtype, pin_memory=like.device.type == "cuda")


def upload(values: NDArray[Any], device: torch.device) -> Tensor:
    """A copy on the device, never a view of the host's memory; nothing waits for it."""
    if device.type != "cuda":
        return torch.tensor(values, device=device)
    tensor = torch.empty(values.shape, dtype=torch.from_numpy(np.empty(0, values.dtype)).dtype, device=device)
    staged = on_host(tensor)
    staged.numpy()[...] = values
    return tensor.copy_(staged, non_blocking=True)


def read(values: Tensor) -> NDArray[Any]:
    """A copy in the host's memory, C-contiguous."""
    values = values.detach().contiguous()
    return np.asarray(on_host(values).copy_(values).numpy())


def read_floats(values: Tensor) -> FloatArray:
    """`read`, as float32."""
    return np.asarray(read(values), np.float32)


class Resident(Generic[S, T]):
    """What was made of an object of the host for the device, kept as long as the object lives; it must not change."""

    def __init__(self, make: Callable[[S], T]) -> None:
        self._make = make
        self._made: dict[int, tuple[weakref.ref[Any], T]] = {}

    def of(self, source: S) -> T:
        """The same for the same object."""
        cached = self._made.get(id(source))
        if cached is not None and cached[0]() is source:
            return cached[1]
        key, all_made = id(source), self._made
        made = self._make(source)
        all_made[key] = (weakref.ref(source, lambda _: all_made.pop(key, None)), made)
        return made
