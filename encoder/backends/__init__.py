"""Where training runs: backends by name, behind one protocol (`protocol`).

``cpu`` is the reference: native kernels, the same bits for the same seed. ``cuda`` needs torch, which is
imported when it is asked for; there, too, the same seed gives the same bytes, which another card need not give.
"""

from __future__ import annotations

from typing import Protocol

from decogs.formats.errors import UsageError

from . import cpu, cuda
from .protocol import (
    ATTRIBUTES,
    BLACK,
    Colour,
    Drawable,
    FixedView,
    Gradients,
    LossValue,
    Optimiser,
    RenderedPicture,
    SplatGradients,
    TrainingKernel,
    ViewGradients,
    gradients_like,
)


class _Backend(Protocol):
    def missing(self) -> str | None:
        """Why this machine cannot train there, in words; None if it can, as far as is known."""
        ...

    def training_kernel(self, threads: int, background: Colour = BLACK) -> TrainingKernel: ...


_BACKENDS: dict[str, _Backend] = {"auto": cpu, "cpu": cpu, "cuda": cuda}
DEVICES = tuple(_BACKENDS)


def check_device(device: str) -> None:
    """Raises UsageError unless training can run on ``device``, one of DEVICES."""
    if device not in _BACKENDS:
        raise UsageError(f"`device` {device}: choose from {', '.join(DEVICES)}")
    missing = _BACKENDS[device].missing()
    if missing:
        raise UsageError(f"`device` {device}: {missing}, or use cpu")


def training_kernel(device: str = "auto", threads: int = 0, background: Colour = BLACK) -> TrainingKernel:
    """The kernel that trains on ``device``, one of DEVICES, over ``background``; raises UsageError if it cannot."""
    check_device(device)
    return _BACKENDS[device].training_kernel(threads, background)


__all__ = [
    "ATTRIBUTES",
    "BLACK",
    "DEVICES",
    "Colour",
    "Drawable",
    "FixedView",
    "Gradients",
    "LossValue",
    "Optimiser",
    "RenderedPicture",
    "SplatGradients",
    "TrainingKernel",
    "ViewGradients",
    "check_device",
    "gradients_like",
    "training_kernel",
]
