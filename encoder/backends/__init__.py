"""Renders with gradients: the native training kernel, and tests against the float64 twin in ``decoder.rasterise``.

``training_kernel`` and ``fixed_view`` choose the backend; ``TrainingKernel`` and ``FixedView``, the native one, are its
interface as well. ``auto`` means the CPU, where the same seed gives the same bytes. The CUDA backend (``cuda``) alone
needs torch and is imported when it is asked for.
"""

from __future__ import annotations

from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError

from .cpu.fixed_view import FixedView
from .cpu.native import HostPicture, LossValue, RenderedPicture, SplatGradients, TrainingKernel, gradients_like
from .incremental_views import IncrementalViews

DEVICES = ("auto", "cpu", "cuda")


def check_device(device: str) -> None:
    """Raises UsageError unless training can run on ``device``, one of DEVICES."""
    if device not in DEVICES:
        raise UsageError(f"`device` {device}: choose from {', '.join(DEVICES)}")
    missing = _missing_for_cuda() if device == "cuda" else None
    if missing:
        raise UsageError(f"`device` cuda: {missing}; install gsplat and a CUDA build of torch, or use cpu")


def _missing_for_cuda() -> str | None:
    try:
        from .cuda.kernel import missing_for_cuda
    except ImportError as error:
        return f"torch cannot be imported ({error})"
    return missing_for_cuda()


def training_kernel(device: str = "auto", threads: int = 0) -> TrainingKernel:
    """The kernel that trains on ``device``, one of DEVICES; raises UsageError where that cannot be."""
    check_device(device)
    if device != "cuda":
        return TrainingKernel(threads)
    from .cuda.kernel import CudaKernel

    return CudaKernel(threads)


def fixed_view(kernel: TrainingKernel, camera: Camera) -> FixedView:
    """A fixed view of the pinhole ``camera`` on the kernel's device."""
    if type(kernel) is TrainingKernel:
        return FixedView(kernel, camera)
    from .cuda.kernel import CudaFixedView, CudaKernel

    return CudaFixedView(kernel, camera) if isinstance(kernel, CudaKernel) else FixedView(kernel, camera)


__all__ = [
    "DEVICES",
    "FixedView",
    "HostPicture",
    "IncrementalViews",
    "LossValue",
    "RenderedPicture",
    "SplatGradients",
    "TrainingKernel",
    "check_device",
    "fixed_view",
    "gradients_like",
    "training_kernel",
]
