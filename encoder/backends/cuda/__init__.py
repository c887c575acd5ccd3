"""The backend of a CUDA device, through torch and gsplat, which are imported when it is asked for.

gsplat's kernels and the fused loss run on a GPU alone. Everything else here is plain torch, and the tests run it on the
processor, with a stand-in for gsplat's functions, against the native kernel and the float64 twin. Figures of a GPU:
report/gpu.md, measured before values and moments moved to the device.
"""

from __future__ import annotations

import importlib

from ..protocol import BLACK, Colour, TrainingKernel


def missing() -> str | None:
    """What keeps this machine from training on CUDA, and what to do; None when nothing is known to."""
    problem = _problem()
    return f"{problem}; install gsplat and a CUDA build of torch" if problem else None


def _problem() -> str | None:
    try:
        import torch
    except ImportError as error:
        return f"torch cannot be imported ({error})"
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} finds no CUDA device"
    try:
        backend = importlib.import_module("gsplat.cuda._backend")
    except Exception as error:  # gsplat compiles itself when first imported, which may fail in any way
        return f"gsplat cannot be imported ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
    if getattr(backend, "_C", backend) is None:
        return "gsplat has no compiled kernels and finds no CUDA toolkit (nvcc) to compile them"
    return None


def training_kernel(threads: int, background: Colour = BLACK) -> TrainingKernel:
    """The device's kernel; ``threads`` of the processor have no part in it."""
    from .cuda_kernel import CudaKernel

    return CudaKernel(background)
