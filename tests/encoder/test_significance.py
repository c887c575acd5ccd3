"""What a change must be worth: judged in loss, taken back for good, and the rest rounded by what bits are worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.codec.scene.lattice import default_lattice, dequantise, quantise
from decogs.codec.scene.state import ARRAYS
from decogs.encoder.backends import Optimiser, SplatGradients
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.coding.changes import quantise_changes
from decogs.encoder.settings.frame import FocusWeights, SignificanceSettings
from decogs.encoder.settings.optimiser import LearningRates
from decogs.encoder.training.losses import focus_loss, whole_picture_loss
from decogs.encoder.training.rate_distortion import cheapest, cheapest_changes
from decogs.encoder.training.significance import picture_weight, revert_insignificant
from decogs.formats.splats import Splats

RATES = LearningRates(*[0.01] * 6)
COUNT = 50


def some_splats(seed: int) -> Splats:
    random = np.random.default_rng(seed)
    shapes = ((COUNT, 3), (COUNT, 3), (COUNT, 4), (COUNT,), (COUNT, 4, 3))
    return Splats(*(random.normal(size=shape).astype(np.float32) for shape in shapes))


def trained(start: Splats, sizes: Splats) -> tuple[Optimiser, SplatGradients]:
    """Three Adam steps: every number moves by .03, whatever its gradient."""
    gradients = SplatGradients(*vars(sizes).values(), np.zeros(COUNT, np.float32))
    optimiser = CpuKernel(1).optimiser(start)
    for _ in range(3):
        optimiser.step(gradients, RATES)
    return optimiser, gradients


def test_changes_are_judged_by_what_they_do_to_the_loss_and_not_by_their_size() -> None:
    start = some_splats(1)
    sizes = Splats(*(np.where(array > 0, 1.0, 0.1).astype(np.float32) for array in vars(some_splats(2)).values()))
    optimiser, gradients = trained(start, sizes)
    old = np.arange(COUNT) < 40
    moved = Splats(*(array.copy() for array in vars(optimiser.splats).values()))
    revert_insignificant(optimiser, start, old, threshold=0.01)  # between .1 * .03 and 1 * .03
    for _ in range(5):
        optimiser.step(gradients, RATES)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        idle = getattr(sizes, name) < 0.5
        idle[~old] = False
        values, was = getattr(optimiser.splats, name), getattr(start, name)
        np.testing.assert_array_equal(values[idle], was[idle])
        assert (values[~idle] != getattr(moved, name)[~idle]).all(), "what is worth it goes on"


def test_geometry_that_light_changes_needs_more_significance() -> None:
    """Every change moves the loss by .03, thrice the threshold: too little only where its factor is 4."""
    start, ones = some_splats(1), Splats(*(np.ones_like(array) for array in vars(some_splats(2)).values()))
    optimiser, _ = trained(start, ones)
    factor = np.where(np.arange(COUNT) < 20, 4, 1).astype(np.float32)
    revert_insignificant(optimiser, start, np.ones(COUNT, bool), 0.01, factor)
    for name in ("means", "log_scales"):
        changed = (getattr(optimiser.splats, name) != getattr(start, name)).all(axis=1)
        np.testing.assert_array_equal(changed, factor == 1)
    for name in ("opacity_logits", "sh"):
        assert (getattr(optimiser.splats, name) != getattr(start, name)).all()


def test_what_is_new_goes_on_however_little_it_does() -> None:
    """It was not there before the frame: nothing can be taken back, and nothing is held."""
    start = some_splats(1)
    optimiser, gradients = trained(start, some_splats(2))
    old = np.arange(COUNT) < 40
    before = Splats(*(array.copy() for array in vars(optimiser.splats).values()))
    for name, array in vars(start).items():
        getattr(before, name)[old] = array[old]
    revert_insignificant(optimiser, before, old, threshold=1e9)
    moved = Splats(*(array.copy() for array in vars(optimiser.splats).values()))
    optimiser.step(gradients, RATES)
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        changed = getattr(optimiser.splats, name) != getattr(moved, name)
        assert changed[~old].all()
        assert not changed[old].any()


def test_no_change_is_taken_back_when_nothing_is_too_little() -> None:
    start = some_splats(1)
    optimiser, _ = trained(start, some_splats(2))
    moved = optimiser.splats.means.copy()
    revert_insignificant(optimiser, start, np.ones(COUNT, bool), threshold=0.0)
    np.testing.assert_array_equal(optimiser.splats.means, moved)


def test_quaternions_keep_the_rotation_they_were_trained_to() -> None:
    start = some_splats(1)
    optimiser, _ = trained(start, some_splats(2))
    moved = optimiser.splats.quaternions.copy()
    revert_insignificant(optimiser, start, np.ones(COUNT, bool), threshold=0.0)
    now = optimiser.splats.quaternions
    # The same up to scale, in float32: a rounding of 6e-8 in each component.
    cosines = (now * moved).sum(axis=1) / np.linalg.norm(now, axis=1) / np.linalg.norm(moved, axis=1)
    np.testing.assert_allclose(cosines, 1, atol=1e-6)
    row, largest = np.arange(COUNT), np.abs(start.quaternions).argmax(axis=1)
    np.testing.assert_array_equal(now[row, largest], start.quaternions[row, largest])


def same_sensitivity(value: float) -> Splats:
    return Splats(*(np.full_like(array, value) for array in vars(some_splats(0)).values()))


LATTICE = default_lattice(3.0)
BEFORE = quantise(some_splats(1), LATTICE)
AFTER = replace(
    some_splats(2),
    means=some_splats(1).means + np.float32(2 * LATTICE.means[0]) * some_splats(2).means,
    quaternions=some_splats(1).quaternions + np.float32(0.1) * some_splats(2).quaternions,
)


@pytest.mark.parametrize(
    ("sensitivity", "settings"),
    [
        (None, SignificanceSettings(rd_lambda=1.0, colour_rd_lambda=1.0)),
        (same_sensitivity(1.0), SignificanceSettings()),
        (same_sensitivity(1e6), SignificanceSettings(rd_lambda=1.0, colour_rd_lambda=1.0)),
    ],
)
def test_changes_are_the_nearest_where_bits_are_worth_nothing_or_errors_everything(
    sensitivity: Splats | None, settings: SignificanceSettings
) -> None:
    written, nearest = (
        quantise_changes(AFTER, BEFORE, LATTICE, sensitivity, settings),
        quantise(AFTER, LATTICE, near=BEFORE),
    )
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(written, name), getattr(nearest, name))


def test_colours_and_opacities_have_a_worth_of_their_own() -> None:
    nearest = quantise(AFTER, LATTICE, near=BEFORE)
    for settings, coarse in (
        (SignificanceSettings(rd_lambda=1e9), ("means", "log_scales", "quaternions")),
        (SignificanceSettings(colour_rd_lambda=1e9), ("opacity_logits", "sh")),
    ):
        written = quantise_changes(AFTER, BEFORE, LATTICE, same_sensitivity(1.0), settings)
        assert {n for n in ARRAYS if (getattr(written, n) != getattr(nearest, n)).any()} == set(coarse)


@pytest.mark.parametrize(("bit", "stays"), [(0.003, {0, 1}), (0.005, {1}), (0.009, set())])
def test_a_step_counts_by_its_size_in_the_attributes_own_unit(bit: float, stays: set[int]) -> None:
    """A fifth of the Gaussians change by one step, which takes two bits more than none: log2(5) against log2(5 / 4).

    A step is 1/12 of base colours, 1/8 of the others, so these go where a bit is worth 1/288 and 1/128.
    """
    values = dequantise(BEFORE, LATTICE)
    values.sh[:10, :2] += np.float32(np.array([LATTICE.sh_dc, LATTICE.sh_rest])[:, None])
    settings = SignificanceSettings(colour_rd_lambda=bit)
    changes = quantise_changes(values, BEFORE, LATTICE, same_sensitivity(1.0), settings).sh - BEFORE.sh
    assert {k for k in range(4) if changes[:, k].any()} == stays


def test_values_that_did_not_change_stay_whatever_bits_are_worth() -> None:
    values = dequantise(BEFORE, LATTICE)
    written = quantise_changes(
        values, BEFORE, LATTICE, same_sensitivity(1.0), SignificanceSettings(rd_lambda=1.0, colour_rd_lambda=1.0)
    )
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(written, name), getattr(BEFORE, name))


@pytest.mark.parametrize("size", [(40, 60), (80, 120)])
def test_a_share_of_a_picture_is_the_same_whatever_the_focus_and_the_size(size: tuple[int, int]) -> None:
    target, mask = np.zeros((3, *size), np.float32), np.zeros(size, bool)
    whole = whole_picture_loss(target, None, 0.2)
    assert picture_weight([whole]) == pytest.approx(1e-6)
    mask[: size[0] // 4] = True
    focused = focus_loss(target, mask, None, FocusWeights(whole=0.0, focus=1.0))
    assert picture_weight([focused]) == pytest.approx(4e-6)
    assert picture_weight([whole, focused]) == pytest.approx(2.5e-6)


def bits_of(column: np.ndarray) -> float:
    """What an entropy coder with a table takes for it."""
    counts = np.unique(column, return_counts=True)[1]
    return float((counts * np.log2(len(column) / counts)).sum())


def test_numbers_that_hardly_show_take_fewer_bits_and_those_that_do_stay() -> None:
    random = np.random.default_rng(5)
    values = random.normal(scale=6, size=(4000, 2)).astype(np.float32)
    change = np.full(values.shape, 0.01, np.float32)
    change[2000:] = 10.0
    chosen, nearest = cheapest(values, change, 1e-3), np.rint(values).astype(np.int32)
    # Half a step there costs 25, far more than what any of the numbers takes in bits.
    np.testing.assert_array_equal(chosen[2000:], nearest[2000:])
    assert (chosen[:2000] != nearest[:2000]).any()
    for channel in range(2):
        (cost, bits), (nearest_cost, nearest_bits) = (
            (((change * (points - values)) ** 2)[:, channel].sum(dtype=float), bits_of(points[:, channel]))
            for points in (chosen, nearest)
        )
        assert bits < 0.9 * nearest_bits
        assert cost + 1e-3 * bits < nearest_cost + 1e-3 * nearest_bits
        assert set(chosen[:, channel]) <= set(nearest[:, channel])


def test_bits_that_are_worth_nothing_change_no_number_and_no_gaussians_are_none() -> None:
    values = np.random.default_rng(6).normal(scale=6, size=(100, 3)).astype(np.float32)
    np.testing.assert_array_equal(cheapest(values, np.zeros_like(values), 0.0), np.rint(values))
    assert cheapest(values[:0], values[:0], 1.0).shape == (0, 3)


def test_numbers_that_do_nothing_become_their_channels_commonest() -> None:
    values = np.array([[3.0, -1.0], [3.2, 8.0], [9.0, -1.4], [-7.0, -1.0]], np.float32)
    np.testing.assert_array_equal(cheapest(values, np.zeros_like(values), 1e-9), [[3, -1]] * 4)


def test_changes_that_hardly_show_take_fewer_bits_and_none_comes_where_there_was_none() -> None:
    random = np.random.default_rng(7)
    changes, loss = random.laplace(scale=1.5, size=(4000, 2)), np.full((4000, 2), 0.02)
    loss[3000:] = 10.0
    chosen, nearest = cheapest_changes(changes, loss, 1e-3), np.rint(changes)
    np.testing.assert_array_equal(chosen[3000:], nearest[3000:])
    assert (chosen[nearest == 0] == 0).all()
    for channel in range(2):
        (cost, bits), (nearest_cost, nearest_bits) = (
            (((loss * (points - changes)) ** 2)[:, channel].sum(), bits_of(points[:, channel]))
            for points in (chosen, nearest)
        )
        assert bits < 0.9 * nearest_bits
        assert cost + 1e-3 * bits < nearest_cost + 1e-3 * nearest_bits


def test_no_changes_at_all() -> None:
    for changes in (np.zeros((0, 3)), np.zeros((5, 3))):
        np.testing.assert_array_equal(cheapest_changes(changes, np.ones_like(changes), 1.0), changes)
