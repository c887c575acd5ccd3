"""Densification: clones and splits as Kerbl 2023 describes them, and whom they are asked of."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cuda_cases import emulated_kernel
from decogs.encoder.backends import TrainingKernel, gradients_like
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.training.densification import grow, strongest
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.splats import Splats
from rasterise_cases import pinhole

ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


def some_splats(count: int, *, sigma: float, seed: int = 1) -> Splats:
    random = np.random.default_rng(seed)
    values = (
        random.normal(size=(count, 3)),
        np.log(sigma * random.uniform(0.2, 1.0, (count, 3))),
        random.normal(size=(count, 4)),
        random.normal(size=count),
        random.normal(size=(count, 4, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def test_small_gaussians_are_copied_exactly() -> None:
    splats, parents = some_splats(20, sigma=0.01), np.array([2, 3, 11])
    growth = grow(splats, parents, 0.01001, np.random.default_rng(0))
    for name in ATTRIBUTES:
        np.testing.assert_array_equal(getattr(growth.children, name), getattr(splats, name)[parents])
    np.testing.assert_array_equal(growth.parent_means, splats.means[parents])
    np.testing.assert_array_equal(growth.parent_log_scales, splats.log_scales[parents])
    np.testing.assert_array_equal(growth.parents, parents)


def test_halves_of_a_split_mirror_each_other_and_are_1_6_times_smaller() -> None:
    splats, parents = some_splats(20, sigma=2.0), np.array([0, 5, 19])
    growth = grow(splats, parents, 0.1, np.random.default_rng(0))
    middle = (growth.children.means.astype(np.float64) + growth.parent_means) / 2
    np.testing.assert_allclose(middle, splats.means[parents], atol=1e-6)
    assert (growth.children.means != splats.means[parents]).all()
    np.testing.assert_allclose(np.exp(growth.children.log_scales), np.exp(splats.log_scales[parents]) / 1.6, rtol=1e-5)
    np.testing.assert_array_equal(growth.parent_log_scales, growth.children.log_scales)
    for name in ("quaternions", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(growth.children, name), getattr(splats, name)[parents])


def test_one_large_axis_is_enough_to_split() -> None:
    splats = some_splats(2, sigma=0.01)
    splats.log_scales[1] = np.log([0.001, 0.5, 0.001])
    growth = grow(splats, np.array([0, 1]), 0.1, np.random.default_rng(0))
    offsets = np.linalg.norm(growth.children.means - splats.means, axis=1)
    assert offsets[0] == 0
    assert offsets[1] > 0.01


def test_offsets_are_drawn_from_the_gaussian_itself() -> None:
    one = some_splats(1, sigma=1.0, seed=4)
    many = Splats(*(np.repeat(getattr(one, name), 4000, axis=0) for name in ATTRIBUTES))
    growth = grow(many, np.arange(4000), 0.01, np.random.default_rng(0))
    offsets = growth.children.means.astype(np.float64) - many.means
    rotation = rotation_matrices(one.quaternions.astype(np.float64))[0]
    expected = rotation @ np.diag(np.exp(2 * one.log_scales[0].astype(np.float64))) @ rotation.T
    # A covariance from 4000 draws is off by sqrt(2 / 4000) = 2.2 % per standard error; 5 of them.
    np.testing.assert_allclose(offsets.T @ offsets / 4000, expected, atol=0.11 * np.abs(expected).max())


def test_the_same_random_state_gives_the_same_growth() -> None:
    splats, parents = some_splats(20, sigma=2.0), np.arange(20)
    first, second, other = (grow(splats, parents, 0.1, np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.children.means, second.children.means)
    assert (first.children.means != other.children.means).all()


def test_strongest_keeps_to_threshold_eligibility_and_room() -> None:
    gradients = np.array([5.0, 9.0, 1.0, 7.0, 3.0, 7.0])
    eligible = np.array([True, True, True, True, True, True])
    np.testing.assert_array_equal(strongest(gradients, eligible, 3.0, 10), [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(strongest(gradients, eligible, 3.0, 2), [1, 3])  # of equals, the first
    np.testing.assert_array_equal(strongest(gradients, eligible, 3.0, 3), [1, 3, 5])
    eligible[1] = False
    np.testing.assert_array_equal(strongest(gradients, eligible, 6.0, 10), [3, 5])
    for room in (0, -3):
        assert len(strongest(gradients, eligible, 0.0, room)) == 0


@pytest.mark.parametrize("make", [CpuKernel, emulated_kernel])
def test_view_gradients_are_means_over_the_views_that_drew_the_gaussian(make: Callable[[], TrainingKernel]) -> None:
    kernel = make()
    gathered = kernel.view_gradients(3)
    for lengths, size in (([2e-3, 0, 0], (64, 48)), ([8e-3, 2e-3, 0], (48, 64))):
        gradients = gradients_like(some_splats(3, sigma=1.0))
        gradients.view[:] = lengths
        gathered.add(gradients, pinhole(*size, 50.0), *([] if size[0] == 64 else [2.0]))
    # 3DGS measures in coordinates from -1 to 1: half the longer side, 32 pixels, to one unit.
    np.testing.assert_allclose(gathered.mean(), [3e-3 * 32, 1e-3 * 32, 0], rtol=1e-6)
