"""The backend of a CUDA device: a rasteriser, a loss and an optimiser of our own, on torch's memory and stream.

torch is imported when it is asked for. The tests run all of it on the processor, the kernels through an emulation of
CUDA's threads, against the native kernel and the float64 twin. Figures of a GPU: report/gpu.md.
"""

from __future__ import annotations

from pathlib import Path

from ..protocol import BLACK, Colour, TrainingKernel


def missing() -> str | None:
    """What keeps this machine from training on CUDA, and what to do; None when nothing is known to."""
    problem = _problem()
    return f"{problem}; install a CUDA build of torch" if problem else None


def _problem() -> str | None:
    try:
        import torch
    except ImportError as error:
        return f"torch cannot be imported ({error})"
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} finds no CUDA device"
    if not (Path(torch.__file__).parent / "lib" / "libcaffe2_nvrtc.so").exists():
        return f"torch {torch.__version__} brings no compiler for CUDA"
    return None


def training_kernel(threads: int, background: Colour = BLACK) -> TrainingKernel:
    """The device's kernel; ``threads`` of the processor have no part in it."""
    from .cuda_kernel import CudaKernel

    return CudaKernel(background)
