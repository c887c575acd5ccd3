"""The training kernel's Adam against torch.optim.Adam in float64."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel

STEP = 1e-5
"""Relative error of a step: some fifteen roundings (1e-6), and float32's 0.999, which is 1.3e-5 off in 1 - beta2 and
weighs old and new squares by as much differently; the bias corrections cancel the rest of it."""
SECOND = 2e-5
"""Relative error of the second moment, whose 1 - beta2 is the rounded one."""


def gradients(count: int, shape: tuple[int, ...]) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    scale = 10.0 ** rng.uniform(-6, 2, shape)
    return [(rng.normal(size=shape) * scale).astype(np.float32) for _ in range(count)]


def torch_steps(value: np.ndarray, steps: list[np.ndarray], rates: np.ndarray) -> tuple[np.ndarray, ...]:
    """Final value and both moments; a parameter of its own for each column, since rates differ."""
    flat = value.reshape(len(value), -1)
    columns = [torch.tensor(flat[:, k].astype(float), requires_grad=True) for k in range(flat.shape[1])]
    groups = [{"params": [c], "lr": float(np.float32(r))} for c, r in zip(columns, rates, strict=True)]
    optimiser = torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15)
    for gradient in steps:
        for k, column in enumerate(columns):
            column.grad = torch.tensor(gradient.reshape(flat.shape)[:, k].astype(float))
        optimiser.step()
    state = [optimiser.state[c] for c in columns]
    found = ([c.detach() for c in columns], [s["exp_avg"] for s in state], [s["exp_avg_sq"] for s in state])
    return tuple(np.stack([x.numpy() for x in part], -1).reshape(value.shape) for part in found)


@pytest.mark.parametrize("shape", [(1,), (37,), (50, 3), (33, 4), (21, 16, 3), (5000, 1, 3), (9, 17)])
@pytest.mark.parametrize("one_rate", [True, False])
def test_steps_are_torchs(shape: tuple[int, ...], one_rate: bool) -> None:
    columns = int(np.prod(shape[1:]))
    rates = np.full(columns, 0.01) if one_rate else np.linspace(0.001, 0.02, columns)
    steps = gradients(6, shape)
    start = np.random.default_rng(8).normal(size=shape).astype(np.float32) * np.float32(0.01)
    value, first, second = start.copy(), np.zeros_like(start), np.zeros_like(start)
    kernel = CpuKernel(2)
    for k, gradient in enumerate(steps):
        rate = 0.01 if one_rate else rates.astype(np.float32)
        kernel.adam(value, gradient, first, second, rate=rate, step=k + 1)
    expected, expected_first, expected_second = torch_steps(start, steps, rates)
    # A moment is a sum of terms of either sign: relative to the sum of their sizes, which the first gradients bound.
    sizes = np.max(np.abs(steps), 0)
    assert (np.abs(first - expected_first) <= 1e-6 * sizes).all()
    assert (np.abs(second - expected_second) <= SECOND * expected_second).all()
    travelled = rates.reshape((1, *shape[1:])) * len(steps) if len(shape) > 1 else rates * len(steps)
    assert (np.abs(value - expected) <= STEP * travelled + 2.0**-24 * len(steps) * np.abs(start).max()).all()


def test_first_step_goes_the_whole_rate() -> None:
    # Kingma 2015, section 2.1: bias correction makes the first step rate * sign(gradient), whatever its size.
    gradient = np.array([1e-12, -1e-6, 1.0, 1e6, 0.0], np.float32)
    value, first, second = np.zeros(5, np.float32), np.zeros(5, np.float32), np.zeros(5, np.float32)
    CpuKernel(1).adam(value, gradient, first, second, rate=0.5, step=1, epsilon=1e-30)
    np.testing.assert_allclose(value, [-0.5, 0.5, -0.5, -0.5, 0.0], rtol=1e-6)


def test_nothing_to_step() -> None:
    nothing = np.zeros((0, 3), np.float32)
    CpuKernel(1).adam(nothing, nothing, nothing, nothing, rate=0.1, step=1)


def test_shapes_that_do_not_fit_are_refused() -> None:
    value = np.zeros((4, 3), np.float32)
    kernel = CpuKernel(1)
    with pytest.raises(ValueError, match="shape"):
        kernel.adam(value, value[:3], value.copy(), value.copy(), rate=0.1, step=1)
