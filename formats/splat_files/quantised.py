"""Activated values of Gaussians, and numbers as bytes: what formats of few bits have in common."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..splats import FloatArray, Splats, logit, sigmoid


def logits(opacities: FloatArray) -> FloatArray:
    """Opacity logits of opacities from 0 to 1, both of which stay finite."""
    return np.asarray(logit(np.clip(opacities.astype(np.float64), 1e-6, 1 - 1e-6)), np.float32)


def opacities(splats: Splats) -> FloatArray:
    """From 0 to 1, float32 (N,)."""
    return sigmoid(splats.opacity_logits.astype(np.float64)).astype(np.float32)


def unit_rotations(splats: Splats) -> FloatArray:
    """Unit quaternions wxyz, float32 (N, 4); one of norm 0 stands for no rotation."""
    values = splats.quaternions.astype(np.float64)
    norms = np.linalg.norm(values, axis=1, keepdims=True)
    unit = np.divide(values, norms, out=np.zeros_like(values), where=norms > 0)
    unit[norms[:, 0] == 0] = (1.0, 0.0, 0.0, 0.0)
    return np.asarray(unit, np.float32)


def to_bytes(values: FloatArray) -> NDArray[np.uint8]:
    """The nearest integers, 0 to 255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
