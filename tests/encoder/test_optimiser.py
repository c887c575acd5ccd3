"""Adam over splats against Adam written out in float64, and what must not move at all, on every backend.

The CUDA backend runs on torch's processor device here: the same code, other kernels.
"""

from __future__ import annotations

import numpy as np
import pytest

from cuda_cases import emulated_kernel
from decogs.encoder.backends import ATTRIBUTES, Optimiser, SplatGradients, TrainingKernel
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.splats import Splats, take_splats

RATES = LearningRates(1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3)
COUNT = 40


@pytest.fixture(params=["native", "emulated"])
def kernel(request: pytest.FixtureRequest) -> TrainingKernel:
    return CpuKernel(2) if request.param == "native" else emulated_kernel()


def some_splats(seed: int, count: int = COUNT) -> Splats:
    random = np.random.default_rng(seed)
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, 4, 3))
    return Splats(*(random.normal(size=shape).astype(np.float32) for shape in shapes))


def gradients_of(splats: Splats) -> SplatGradients:
    return SplatGradients(*(getattr(splats, name) for name in ATTRIBUTES), np.zeros(len(splats), np.float32))


def zeros_of(splats: Splats) -> Splats:
    return Splats(*(np.zeros_like(getattr(splats, name)) for name in ATTRIBUTES))


def rates_of(name: str) -> np.ndarray | float:
    if name == "sh":
        return np.array([RATES.sh_dc] + [RATES.sh_rest] * 3).reshape(1, 4, 1)
    return float(getattr(RATES, name))


def adam(values: Splats, gradients: list[Splats]) -> dict[str, np.ndarray]:
    """Kingma 2015, algorithm 1, in float64."""
    found = {}
    for name in ATTRIBUTES:
        value = getattr(values, name).astype(np.float64)
        first, second = np.zeros_like(value), np.zeros_like(value)
        for step, gradient in enumerate(gradients, start=1):
            g = getattr(gradient, name).astype(np.float64)
            first, second = 0.9 * first + 0.1 * g, 0.999 * second + 0.001 * g * g
            value = value - rates_of(name) * (first / (1 - 0.9**step)) / (np.sqrt(second / (1 - 0.999**step)) + 1e-15)
        found[name] = value
    return found


def equal_bits(first: Splats, second: Splats) -> bool:
    return all(getattr(first, name).tobytes() == getattr(second, name).tobytes() for name in ATTRIBUTES)


def test_steps_are_those_of_adam(kernel: TrainingKernel) -> None:
    start, gradients = some_splats(1), [some_splats(seed) for seed in (2, 3, 4)]
    optimiser = kernel.optimiser(start)
    for gradient in gradients:
        optimiser.step(gradients_of(gradient), RATES)
    for name, expected in adam(start, gradients).items():
        # Three float32 steps of at most 6e-3 on values of size 1: a few units in the last place (1.2e-7).
        np.testing.assert_allclose(getattr(optimiser.splats, name), expected, rtol=5e-7, atol=5e-7)
    assert equal_bits(start, some_splats(1)), "the caller's arrays must not be stepped"


def test_zero_gradients_with_zero_moments_move_nothing(kernel: TrainingKernel) -> None:
    start = some_splats(1)
    optimiser = kernel.optimiser(start)
    optimiser.step(gradients_of(zeros_of(start)), RATES)
    assert equal_bits(optimiser.splats, start)


def test_remembered_momentum_moves_its_rows_and_no_other(kernel: TrainingKernel) -> None:
    start = some_splats(1)
    before, after = kernel.optimiser(start), kernel.optimiser(start)
    before.step(gradients_of(some_splats(2)), RATES)
    rows = np.arange(10, 20)
    after.copy_momentum(before, rows, rows + 5)
    after.step(gradients_of(zeros_of(start)), RATES)
    step = after.splats.means - start.means
    assert not np.delete(step, rows, axis=0).any()
    assert (step[rows] != 0).all()
    again = kernel.optimiser(before.splats)
    again.copy_momentum(before, np.arange(COUNT), np.arange(COUNT))
    for each in (before, again):
        each.step(gradients_of(some_splats(3)), RATES)
    assert equal_bits(before.splats, again.splats), "as its second step"


def test_an_attribute_with_rate_zero_stays(kernel: TrainingKernel) -> None:
    start = some_splats(1)
    optimiser = kernel.optimiser(start)
    optimiser.step(gradients_of(some_splats(2)), LearningRates(0.0, 1e-3, 1e-3, 0.0, 1e-3, 0.0))
    np.testing.assert_array_equal(optimiser.splats.means, start.means)
    np.testing.assert_array_equal(optimiser.splats.opacity_logits, start.opacity_logits)
    np.testing.assert_array_equal(optimiser.splats.sh[:, 1:], start.sh[:, 1:])
    assert (optimiser.splats.sh[:, 0] != start.sh[:, 0]).all()
    assert (optimiser.splats.log_scales != start.log_scales).all()


def test_added_rows_come_without_momentum_and_leave_the_others_theirs(kernel: TrainingKernel) -> None:
    start, added = some_splats(1), some_splats(9, 5)
    grown, alone = kernel.optimiser(start), kernel.optimiser(start)
    for optimiser in (grown, alone):
        optimiser.step(gradients_of(some_splats(2)), RATES)
    grown.append(added)
    new = np.arange(COUNT + 5) >= COUNT
    assert equal_bits(take_splats(grown.splats, new), added)
    assert not grown.gradient_size("means")[new].any()
    gradient = some_splats(3, COUNT + 5)
    alone.step(gradients_of(take_splats(gradient, ~new)), RATES)
    grown.step(gradients_of(gradient), RATES)
    assert equal_bits(take_splats(grown.splats, ~new), alone.splats)
    assert (grown.splats.means[new] != added.means).all()


def test_kept_rows_take_their_momentum_with_them(kernel: TrainingKernel) -> None:
    order = np.array([30, 2, 11])
    thinned, whole = kernel.optimiser(some_splats(1)), kernel.optimiser(some_splats(1))
    for optimiser in (thinned, whole):
        optimiser.step(gradients_of(some_splats(2)), RATES)
    thinned.keep(order)
    assert len(thinned.splats) == 3
    thinned.step(gradients_of(take_splats(some_splats(3), order)), RATES)
    whole.step(gradients_of(some_splats(3)), RATES)
    assert equal_bits(thinned.splats, take_splats(whole.splats, order))


def test_scaled_rates() -> None:
    assert RATES.scaled(0.5) == LearningRates(5e-4, 1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3)


def test_frozen_values_stay_and_the_rest_goes_as_without(kernel: TrainingKernel) -> None:
    start, gradients = some_splats(1), gradients_of(some_splats(2))
    free, freezing = (kernel.optimiser(start) for _ in range(2))
    frozen = {name: np.random.default_rng(3).random(getattr(start, name).shape) < 0.5 for name in ATTRIBUTES}
    freezing.freeze(frozen)
    for optimiser in (free, freezing, free, freezing):
        optimiser.step(gradients, RATES)
    for name in ATTRIBUTES:
        expected = np.where(frozen[name], getattr(start, name), getattr(free.splats, name))
        np.testing.assert_array_equal(getattr(freezing.splats, name), expected)


def test_attributes_are_frozen_one_after_the_other(kernel: TrainingKernel) -> None:
    start, gradients = some_splats(1), gradients_of(some_splats(2))
    optimiser = kernel.optimiser(start)
    optimiser.freeze({"means": np.ones((COUNT, 3), bool)})
    optimiser.step(gradients, RATES)
    later = optimiser.splats.log_scales.copy()
    optimiser.freeze({"log_scales": np.ones((COUNT, 3), bool)})
    optimiser.step(gradients, RATES)
    np.testing.assert_array_equal(optimiser.splats.means, start.means)
    np.testing.assert_array_equal(optimiser.splats.log_scales, later)
    assert (later != start.log_scales).all()


def test_a_copy_goes_on_as_the_original_would_and_apart_from_it(kernel: TrainingKernel) -> None:
    gradients = gradients_of(some_splats(2))
    original = kernel.optimiser(some_splats(1), beta1=0.7, beta2=0.99)
    original.step(gradients, RATES)
    copy, there = original.copy(), original.splats.sh.copy()
    copy.step(gradients, RATES)
    np.testing.assert_array_equal(original.splats.sh, there)
    original.step(gradients, RATES)
    assert equal_bits(copy.splats, original.splats)


def test_nothing_is_frozen_any_more_once_rows_come_or_go(kernel: TrainingKernel) -> None:
    start, gradients = some_splats(1), gradients_of(some_splats(2))
    for change in (lambda o: o.keep(np.arange(COUNT)), lambda o: o.append(take_splats(start, np.arange(0)))):
        optimiser = kernel.optimiser(start)
        optimiser.freeze({"means": np.ones((COUNT, 3), bool)})
        change(optimiser)
        optimiser.step(gradients, RATES)
        assert (optimiser.splats.means != start.means).all()


def test_gradient_size_is_the_root_mean_square_of_what_came(kernel: TrainingKernel) -> None:
    start, gradients = some_splats(1), [some_splats(seed) for seed in (2, 3, 4)]
    optimiser = kernel.optimiser(start, beta2=0.9)
    assert not optimiser.gradient_size("means").any(), "nothing has come yet"
    for gradient in gradients:
        optimiser.step(gradients_of(gradient), RATES)
    weights = np.array([0.81, 0.9, 1.0])
    squares = sum(w * g.means.astype(np.float64) ** 2 for w, g in zip(weights, gradients, strict=True))
    # float32 moments: a few units in the last place (1.2e-7).
    np.testing.assert_allclose(optimiser.gradient_size("means"), np.sqrt(squares / weights.sum()), rtol=1e-6)


def test_what_is_put_there_is_trained_on_and_momentum_stays(kernel: TrainingKernel) -> None:
    start, gradients, rows = some_splats(1), gradients_of(some_splats(2)), np.array([3, 17, 20], np.int64)
    optimiser = kernel.optimiser(start)
    optimiser.step(gradients, RATES)
    size = optimiser.gradient_size("means")
    new, old = some_splats(5, 3), optimiser.splats.opacity_logits.copy()
    optimiser.put(rows, means=new.means, opacity_logits=new.opacity_logits)
    optimiser.put(sh=start.sh)
    np.testing.assert_array_equal(optimiser.splats.means[rows], new.means)
    np.testing.assert_array_equal(optimiser.splats.opacity_logits[rows], new.opacity_logits)
    np.testing.assert_array_equal(optimiser.splats.sh, start.sh)
    np.testing.assert_array_equal(optimiser.gradient_size("means"), size)
    others = np.setdiff1d(np.arange(COUNT), rows)
    np.testing.assert_array_equal(optimiser.splats.opacity_logits[others], old[others])
    assert (optimiser.splats.means[others] != start.means[others]).all()
    optimiser.step(gradients, RATES)
    # The same gradient twice: Adam moves every number by its rate.
    np.testing.assert_allclose(np.abs(optimiser.splats.means[rows] - new.means), RATES.means, rtol=1e-3)


def test_no_backend_lets_gaussians_grow_longer_than_the_limit() -> None:
    """Some are too long at the start, some become so, and their largest size is limited alike."""
    start, rates = some_splats(1), LearningRates(0, 0.5, 0, 0, 0, 0)
    start.log_scales[:20] *= np.float32(0.1)
    sizes, free = [], kernel_free(start, rates)
    for kernel in (CpuKernel(1), emulated_kernel()):
        optimiser: Optimiser = kernel.optimiser(start)
        for seed in (2, 3):
            optimiser.step(gradients_of(some_splats(seed)), rates, max_stretch=2.0)
        sizes.append(optimiser.splats.log_scales)
    # float32 sums of numbers up to 4.
    np.testing.assert_allclose(sizes[1], sizes[0], atol=2e-6)
    ordered = np.sort(sizes[1], axis=1)
    before = np.sort(start.log_scales, axis=1)
    allowed = np.maximum(before[:, 2] - before[:, 1], np.log(2.0))
    assert (ordered[:, 2] - ordered[:, 1] <= allowed + 1e-6).all()
    assert (sizes[1] != free).any(axis=1).sum() >= COUNT / 4


def kernel_free(start: Splats, rates: LearningRates) -> np.ndarray:
    """Sizes after the same steps without a limit."""
    optimiser = emulated_kernel().optimiser(start)
    for seed in (2, 3):
        optimiser.step(gradients_of(some_splats(seed)), rates)
    return optimiser.splats.log_scales


def test_values_read_from_a_device_are_copies_that_nobody_writes_by_mistake() -> None:
    optimiser = emulated_kernel().optimiser(some_splats(1))
    read = optimiser.splats
    with pytest.raises(ValueError, match="read-only"):
        read.means[:] = 0
    optimiser.step(gradients_of(some_splats(2)), RATES)
    assert equal_bits(read, some_splats(1))
