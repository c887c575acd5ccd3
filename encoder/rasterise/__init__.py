"""Renders with gradients: the native training kernel, and tests against the float64 twin in ``decoder.rasterise``.

A CUDA backend (gsplat: ``rasterize_to_pixels`` with tile masks, ``packed=False``) fits behind ``TrainingKernel``'s
methods.
"""

from .native import Canvas, LossValue, Picture, SplatGradients, TrainingKernel

__all__ = ["Canvas", "LossValue", "Picture", "SplatGradients", "TrainingKernel"]
