"""Renders with gradients: the native training kernel, and tests against the float64 twin in ``decoder.rasterise``.

A CUDA backend (gsplat: ``rasterize_to_pixels`` with tile masks, ``packed=False``) fits behind ``TrainingKernel``'s
methods.
"""

from .fixed_view import FixedView
from .native import LossValue, Picture, SplatGradients, TrainingKernel, gradients_like

__all__ = ["FixedView", "LossValue", "Picture", "SplatGradients", "TrainingKernel", "gradients_like"]
