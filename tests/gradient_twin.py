"""Gradients of the training kernel against automatic differentiation of the float64 twin, for the tests that compare
the two."""

from __future__ import annotations

import numpy as np
import torch

import rasterise_cases as cases
from decogs.encoder.backends import SplatGradients
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel

FIELDS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
GRADIENT_ROUNDINGS = 150
"""A gradient sums some hundred pixels' terms, each through some fifty operations whose errors are of either sign; seen:
at most 55 roundings of the largest gradient (75 in the needles' opacities)."""
ROW_TOLERANCE = 5e-4
"""A Gaussian's own gradient may be a small difference of its pixels' terms; seen: 6e-5 of its length."""


def twin_gradients(
    case: cases.Case, v_rgb: np.ndarray, v_alpha: np.ndarray, v_depth: np.ndarray
) -> dict[str, np.ndarray]:
    """Gradients of the stored values, and ``view``, of sum(v rgb) + sum(v alpha) + sum(v depth) by torch in float64."""
    arrays = [torch.tensor(getattr(case.splats, f).astype(float), requires_grad=True) for f in FIELDS]
    rgb, alpha, depth, centres = cases.twin(case, torch, arrays)
    centres.retain_grad()
    v = [torch.tensor(plane.astype(float)) for plane in (v_rgb, v_alpha, v_depth)]
    ((rgb * v[0]).sum() + (alpha * v[1]).sum() + (depth * v[2]).sum()).backward()
    gradients = {f: a.grad.numpy() for f, a in zip(FIELDS, arrays, strict=True)}
    return gradients | {"view": np.linalg.norm(centres.grad.numpy(), axis=1)}


def kernel_gradients(case: cases.Case, planes: tuple[np.ndarray, ...], threads: int = 1) -> SplatGradients:
    kernel = CpuKernel(threads)
    kernel.forward(case.splats, case.camera, case.background, depth=True)
    return kernel.backward(case.splats, planes[0], v_alpha=planes[1], v_depth=planes[2])


def compare_gradient(
    actual: np.ndarray, expected: np.ndarray, *, roundings: float = GRADIENT_ROUNDINGS, row: float = ROW_TOLERANCE
) -> None:
    """Every value to ``roundings`` of the largest; every row that matters to ``row`` of its length."""
    largest = np.abs(expected).max()
    cases.compare(actual, expected, roundings * cases.ROUNDING * largest)
    rows = expected.reshape(len(expected), -1)
    lengths = np.linalg.norm(rows, axis=1)
    errors = np.linalg.norm(actual.reshape(rows.shape) - rows, axis=1)
    matter = lengths > 1e-3 * lengths.max()
    worst = int(np.argmax(np.where(matter, errors / np.maximum(lengths, 1e-30), 0)))
    assert errors[worst] <= row * lengths[worst], f"row {worst} off by {errors[worst] / lengths[worst]:.3g}"
