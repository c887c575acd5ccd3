"""The lattice: nearest integers, exact decoding, quaternion scale and sign, refusals instead of clipping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decogs.codec.scene.lattice import Lattice, default_lattice, dequantise, quantise, robust_extent
from decogs.codec.scene.state import take_rows
from decogs.formats.errors import TrainingError
from decogs.formats.splats import Splats, empty_splats, take_splats

LATTICE = Lattice((10.0, -2.0, 0.0), (0.001, 0.002, 0.003), 0.05, 1 / 128, 0.2, 1 / 64, 1 / 32)


def random_splats(seed: int, n: int = 50, degree: int = 1) -> Splats:
    rng = np.random.default_rng(seed)

    def draw(*shape: int) -> np.ndarray:
        return rng.normal(size=(n, *shape)).astype(np.float32)

    return Splats(draw(3), draw(3), draw(4), draw(), draw((degree + 1) ** 2, 3))


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rotation angle in radians between quaternions, whatever their norms and signs."""
    a, b = (q.astype(np.float64) / np.linalg.norm(q.astype(np.float64), axis=1)[:, None] for q in (first, second))
    return 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1))


def test_values_come_back_within_half_a_step() -> None:
    splats = random_splats(0)
    back = dequantise(quantise(splats, LATTICE), LATTICE)
    # Half a step, and float32 rounding of values of magnitude up to 16 (2**-20).
    slack = 2.0**-20
    assert (np.abs(back.means - splats.means) <= np.array(LATTICE.means) / 2 + slack).all()
    assert np.abs(back.log_scales - splats.log_scales).max() <= LATTICE.log_scales / 2 + slack
    assert np.abs(back.opacity_logits - splats.opacity_logits).max() <= LATTICE.opacity_logits / 2 + slack
    assert np.abs(back.sh[:, 0] - splats.sh[:, 0]).max() <= LATTICE.sh_dc / 2 + slack
    assert np.abs(back.sh[:, 1:] - splats.sh[:, 1:]).max() <= LATTICE.sh_rest / 2 + slack


def test_decoding_rounds_once_from_float64() -> None:
    points = quantise(random_splats(1), LATTICE)
    expected = [
        [
            np.float32(float(i) * step + origin)
            for i, step, origin in zip(row, LATTICE.means, LATTICE.origin, strict=True)
        ]
        for row in points.means.tolist()
    ]
    assert np.array_equal(dequantise(points, LATTICE).means, np.array(expected, np.float32))


@given(st.integers(0, 2**32 - 1))
def test_lattice_points_are_their_own_nearest(seed: int) -> None:
    points = quantise(random_splats(seed, n=20), LATTICE)
    again = quantise(dequantise(points, LATTICE), LATTICE, near=points)
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        assert np.array_equal(getattr(again, name), getattr(points, name))


def test_halves_round_to_even() -> None:
    lattice = replace(LATTICE, log_scales=0.5)
    splats = replace(random_splats(0, n=1), log_scales=np.array([[0.25, 0.75, -0.25]], np.float32))
    assert quantise(splats, lattice).log_scales.tolist() == [[0, 2, 0]]


def test_quaternions_have_their_largest_component_at_plus_one() -> None:
    quaternions = quantise(random_splats(3, n=500), LATTICE).quaternions
    assert (quaternions.max(axis=1) == 128).all()
    assert (quaternions.min(axis=1) >= -128).all()


def test_quaternion_angle_error_is_bounded_by_the_step() -> None:
    splats = random_splats(4, n=2000)
    back = dequantise(quantise(splats, LATTICE), LATTICE)
    # Three components off by at most half a step each, on a quaternion of norm >= 1, twice for the angle.
    assert angles(back.quaternions, splats.quaternions).max() <= 2 * np.sqrt(3) * LATTICE.quaternions / 2 * 1.01


@pytest.mark.parametrize("flip", [1, -1])
def test_a_small_turn_changes_few_integers_whatever_the_sign(flip: int) -> None:
    splats = random_splats(5, n=400)
    before = quantise(splats, LATTICE)
    turned = splats.quaternions / np.linalg.norm(splats.quaternions, axis=1, keepdims=True)
    turned = flip * 3.7 * (turned + np.random.default_rng(0).normal(0, 0.01, turned.shape))
    after = quantise(replace(splats, quaternions=turned.astype(np.float32)), LATTICE, near=before)
    change = np.abs(after.quaternions.astype(np.int64) - before.quaternions)
    # A component moves by 0.05 at most (5 sigma of 0.01), relative to a largest one of at least a half.
    assert change.max() <= 128 * 0.05 * 2 * 2 + 1
    assert (change.min(axis=1) == 0).all()
    assert (
        angles(dequantise(after, LATTICE).quaternions, turned).max() <= 2 * np.sqrt(3) * LATTICE.quaternions / 2 / 0.7
    )


def test_a_spinning_quaternion_keeps_its_scale() -> None:
    points = None
    for t in np.linspace(0, 40, 500):
        q = np.array([[np.cos(t), np.sin(t), np.cos(1.7 * t), np.sin(2.3 * t)]], np.float32)
        splats = replace(random_splats(0, n=1), quaternions=q)
        points = quantise(splats, LATTICE, near=points)
        assert 0.69 * 128 <= np.abs(points.quaternions).max() <= 1.51 * 128
        assert angles(dequantise(points, LATTICE).quaternions, q).max() <= 0.03


def test_zero_tiny_and_huge_quaternions_stay_rotations() -> None:
    q = np.array([[0, 0, 0, 0], [1e-40, 0, 0, 1e-40], [3e38, -3e38, 0, 0], [-0.0, 0, 0, -2]], np.float32)
    points = quantise(replace(random_splats(0, n=4), quaternions=q), LATTICE).quaternions
    assert points.tolist() == [[128, 0, 0, 0], [128, 0, 0, 128], [128, -128, 0, 0], [0, 0, 0, 128]]


def test_a_quaternion_of_zeros_in_a_stream_decodes_to_the_identity() -> None:
    points = quantise(random_splats(0, n=2), LATTICE)
    quaternions = points.quaternions.copy()
    quaternions[1] = 0
    assert dequantise(replace(points, quaternions=quaternions), LATTICE).quaternions[1].tolist() == [1, 0, 0, 0]


def test_any_integers_decode_to_values_whose_activations_are_finite() -> None:
    points = quantise(random_splats(0, n=2), LATTICE)
    for value in (np.iinfo(np.int32).min, np.iinfo(np.int32).max):
        extreme = type(points)(*(np.full_like(array, value) for array in vars(points).values()))
        splats = dequantise(extreme, replace(LATTICE, log_scales=1e6, opacity_logits=1e6, means=(1e6, 1e6, 1e6)))
        for array in vars(splats).values():
            assert np.isfinite(array).all()
        assert np.isfinite(np.exp(splats.log_scales)).all()
        assert np.isfinite(np.exp(-splats.opacity_logits)).all()


@pytest.mark.parametrize("name", ["means", "log_scales", "quaternions", "opacity_logits", "sh"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused_by_name(name: str, bad: float) -> None:
    splats = random_splats(0)
    array = getattr(splats, name).copy()
    array.reshape(len(array), -1)[[3, 7], 0] = bad
    with pytest.raises(TrainingError, match=f"{name} of 2 Gaussians"):
        quantise(replace(splats, **{name: array}), LATTICE)


def test_values_beyond_32_bits_are_refused_not_clipped() -> None:
    splats = replace(random_splats(0, n=1), means=np.array([[1e9, 0, 0]], np.float32))
    with pytest.raises(TrainingError, match="32 bits"):
        quantise(splats, LATTICE)


def test_no_gaussians_at_all() -> None:
    points = quantise(empty_splats(2), LATTICE, near=quantise(empty_splats(2), LATTICE))
    assert len(points) == 0
    assert len(dequantise(points, LATTICE)) == 0


def test_rows_decode_alone_as_they_do_together() -> None:
    points, rows = quantise(random_splats(6), LATTICE), np.array([4, 9, 30])
    whole, part = take_splats(dequantise(points, LATTICE), rows), dequantise(take_rows(points, rows), LATTICE)
    for name, array in vars(whole).items():
        assert np.array_equal(array, getattr(part, name))


def test_default_lattice_follows_extent_and_scale() -> None:
    fine, coarse = default_lattice(8.0, centre=(1.0, 2.0, 3.0)), default_lattice(8.0, scale=4.0)
    assert fine.means == pytest.approx((8 / 5500,) * 3)
    assert fine.origin == (1.0, 2.0, 3.0)
    assert coarse.means == pytest.approx((32 / 5500,) * 3)
    assert coarse.sh_rest == 4 * fine.sh_rest
    with pytest.raises(TrainingError, match="extent"):
        default_lattice(float("nan"))


def test_robust_extent_ignores_floaters() -> None:
    means = np.random.default_rng(0).uniform(-1, 1, (10000, 3))
    means[:100] *= 1e6
    extent, centre = robust_extent(means)
    assert 1.8 < extent < 2.0
    assert np.abs(centre).max() < 0.05


def test_a_quaternion_that_starts_afresh_takes_the_sign_nearer_to_the_previous_one() -> None:
    """The previous one's largest component is small now, so that its scale cannot be kept: fewest integers change."""
    one = round(1 / LATTICE.quaternions)
    before = quantise(with_quaternion([1, 0, 0, 0]), LATTICE)
    near = quantise(with_quaternion([0.25, -1, 0, 0]), LATTICE, near=before)
    np.testing.assert_array_equal(near.quaternions, [[one // 4, -one, 0, 0]])
    np.testing.assert_array_equal(quantise(with_quaternion([0.25, -1, 0, 0]), LATTICE).quaternions[:, 1], [one])


@pytest.mark.parametrize(
    ("step", "before", "now"),
    [(0.7 / 32, 32, 32), (0.7 / 32, 31, 46), (1 / 32, 48, 48), (1 / 32, 49, 32)],
    ids=["seven tenths", "less", "one and a half", "more"],
)
def test_a_quaternion_keeps_its_scale_up_to_the_bounds_themselves(step: float, before: int, now: int) -> None:
    lattice, splats = replace(LATTICE, quaternions=step), with_quaternion([1, 0.5, 0, 0])
    near = replace(quantise(splats, lattice), quaternions=np.array([[before, 0, 0, 0]], np.int32))
    assert quantise(splats, lattice, near=near).quaternions.tolist() == [[now, now // 2, 0, 0]]


def test_quaternions_beyond_32_bits_are_refused_as_other_values_are() -> None:
    with pytest.raises(TrainingError, match="quaternions do not fit 32 bits"):
        quantise(with_quaternion([1, 0.5, 0, 0]), replace(LATTICE, quaternions=1e-11))


def with_quaternion(quaternion: list[float]) -> Splats:
    return replace(random_splats(0, 1), quaternions=np.array([quaternion], np.float32))
