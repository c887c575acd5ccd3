"""The backend of the processor: native kernels, the same bits for the same seed; the float64 twin tests them."""

from __future__ import annotations

from ..protocol import BLACK, Colour, TrainingKernel


def missing() -> str | None:
    """Nothing: every machine has a processor."""
    return None


def training_kernel(threads: int, background: Colour = BLACK) -> TrainingKernel:
    """The native kernel; ``threads`` 0 means all processors."""
    from .cpu_kernel import CpuKernel

    return CpuKernel(threads, background)
