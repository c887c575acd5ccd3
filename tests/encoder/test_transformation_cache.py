"""The transformation cache against a float64 twin written out here, an Adam over the whole table, and known motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from decogs.encoder.transformation_cache import (
    CacheSettings,
    CacheWeights,
    TransformationCache,
    level_indices,
    level_weights,
)
from decogs.formats.errors import TrainingError, UsageError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

SMALL = CacheSettings(levels=5, features=2, table_log2=9, base_resolution=4, hidden_width=12, translation_scale=0.7)
LOW, HIGH = np.array([-1.0, -2.0, 0.5]), np.array([1.0, 2.0, 3.5])


def gaussians(count: int, seed: int = 0) -> tuple[F32, F32]:
    rng = np.random.default_rng(seed)
    means = LOW + (HIGH - LOW) * rng.random((count, 3))
    return means.astype(np.float32), rng.normal(size=(count, 4)).astype(np.float32)


def strong_weights(cache: TransformationCache, seed: int = 5) -> CacheWeights:
    """Random weights of ordinary size, so that every derivative is far from zero."""
    rng = np.random.default_rng(seed)
    own = cache.weights()
    matrices = tuple((rng.normal(size=m.shape) / np.sqrt(m.shape[1])).astype(np.float32) for m in own.matrices)
    biases = tuple((b + 0.1 * rng.normal(size=b.shape)).astype(np.float32) for b in own.biases)
    return CacheWeights(rng.normal(size=own.grid.shape).astype(np.float32), matrices, biases)


def quaternion_product(a: F64, b: F64) -> F64:
    """Scalar-vector form: (aw bw - a.b, aw b + bw a + a x b)."""
    w = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(1, keepdims=True)
    return np.hstack([w, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])


def twin(settings: CacheSettings, weights: CacheWeights, anchors: F32, means: F64, quaternions: F64) -> tuple[F64, F64]:
    """The whole map in float64, for Gaussians inside the box; the grid is read at ``anchors``."""
    points = (anchors.astype(np.float64) - LOW) / (HIGH - LOW)
    features = []
    for level in range(settings.levels):
        read = weights.grid[level].astype(np.float64)[level_indices(settings, points, level)]
        features.append((level_weights(settings, points, level)[:, :, None] * read).sum(1))
    x = np.hstack(features)
    for layer, (matrix, bias) in enumerate(zip(weights.matrices, weights.biases, strict=True)):
        x = x @ matrix.astype(np.float64).T + bias
        if layer < len(weights.matrices) - 1:
            x = np.maximum(x, 0.0)
    q, dq = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (quaternions, x[:, 3:]))
    return means + settings.translation_scale * x[:, :3], quaternion_product(q, dq)


def perturbed(weights: CacheWeights, along: CacheWeights, size: float) -> CacheWeights:
    def moved(value: F32, direction: F32) -> F64:
        return value.astype(np.float64) + size * direction.astype(np.float64)

    return CacheWeights(
        moved(weights.grid, along.grid),  # type: ignore[arg-type]
        tuple(moved(a, b) for a, b in zip(weights.matrices, along.matrices, strict=True)),  # type: ignore[misc]
        tuple(moved(a, b) for a, b in zip(weights.biases, along.biases, strict=True)),  # type: ignore[misc]
    )


def arrays(weights: CacheWeights) -> list[F32]:
    return [weights.grid, *weights.matrices, *weights.biases]


def train(cache: TransformationCache, steps: int, seed: int = 1) -> None:
    """Some steps on gradients that depend on what the cache gave (so that every step differs)."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        means, quaternions = cache.moved()
        cache.backward(
            (means + 0.1 * rng.normal(size=means.shape)).astype(np.float32),
            (quaternions * 0.2 + 0.1 * rng.normal(size=quaternions.shape)).astype(np.float32),
        )
        cache.step()


@pytest.fixture
def torch_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


# -- the map ----------------------------------------------------------------------------------------------------------


def test_starts_at_the_identity() -> None:
    cache = TransformationCache(LOW, HIGH, CacheSettings(), seed=3)
    means, quaternions = gaussians(3000)
    cache.place(means, quaternions)
    moved, turned = cache.moved()
    np.testing.assert_array_equal(moved, means)
    wide = quaternions.astype(np.float64)
    np.testing.assert_array_max_ulp(turned, (wide / np.linalg.norm(wide, axis=1)[:, None]).astype(np.float32), 1)
    assert moved.dtype == turned.dtype == np.float32
    assert moved.flags.c_contiguous
    assert turned.flags.c_contiguous


def test_equals_the_float64_twin() -> None:
    """Tolerance: 1e-5 is about 80 float32 roundings of values near 1, for sums of 40 feature products and 3 layers."""
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    weights = strong_weights(cache)
    cache.set_weights(weights)
    means, quaternions = gaussians(4500)  # three chunks
    cache.place(means, quaternions)
    expected = twin(SMALL, weights, means, means.astype(np.float64), quaternions.astype(np.float64))
    for ours, theirs in zip(cache.moved(), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(cache.moved()[1], axis=1), 1.0, rtol=0, atol=5e-7)


def test_gradients_equal_finite_differences_of_the_float64_twin() -> None:
    """Central differences in float64 with step 1e-6 (error about 1e-9); float32 sums leave a few 1e-6 of the norm."""
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    weights = strong_weights(cache)
    cache.set_weights(weights)
    anchors, quaternions = gaussians(60)
    cache.place(anchors, quaternions)
    means, quaternions = (v + np.float32(0.3) for v in (anchors, quaternions))
    cache.rebase(means, quaternions)
    cache.moved()
    rng = np.random.default_rng(9)
    v_means, v_quaternions = (rng.normal(size=(60, n)).astype(np.float32) for n in (3, 4))
    base_gradients = cache.backward(v_means, v_quaternions)
    gradients = cache.gradients()

    def loss(w: CacheWeights, m: F64, q: F64) -> float:
        moved, turned = twin(SMALL, w, anchors, m, q)
        return float((moved * v_means).sum() + (turned * v_quaternions).sum())

    m, q = means.astype(np.float64), quaternions.astype(np.float64)
    step = 1e-6
    flat = arrays(gradients)
    for part in range(len(flat)):  # each array on its own, along three random directions
        for _ in range(3):
            directions = [np.zeros_like(a) for a in flat]
            directions[part] = rng.normal(size=flat[part].shape).astype(np.float32)
            layers = len(gradients.matrices)
            along = CacheWeights(directions[0], tuple(directions[1 : 1 + layers]), tuple(directions[1 + layers :]))
            slope = loss(perturbed(weights, along, step), m, q) - loss(perturbed(weights, along, -step), m, q)
            ours = float((flat[part].astype(np.float64) * directions[part]).sum())
            assert slope / (2 * step) == pytest.approx(ours, abs=1e-5 * float(np.linalg.norm(flat[part])))
    for k, gradient in enumerate(base_gradients):
        direction = rng.normal(size=gradient.shape)
        shift = [np.zeros_like(m), np.zeros_like(q)]
        shift[k] = step * direction
        slope = loss(weights, m + shift[0], q + shift[1]) - loss(weights, m - shift[0], q - shift[1])
        ours = float((gradient * direction).sum())
        assert slope / (2 * step) == pytest.approx(ours, abs=1e-5 * float(np.linalg.norm(gradient)))


def test_hash_and_dense_indices_of_known_cells() -> None:
    """Instant-NGP's equation 4 worked out by hand in Python's integers; dense levels count x fastest."""
    settings = CacheSettings()
    assert settings.resolutions()[:4] == [16, 32, 64, 128]
    assert settings.resolutions()[15] == 2**19
    point = np.array([[0.37, 0.81, 0.55]])
    for level in range(16):
        resolution = settings.resolutions()[level]
        cell = [int(v * (resolution - 1)) for v in point[0]]
        for corner, index in enumerate(level_indices(settings, point, level)[0]):
            x, y, z = (c + (corner >> k & 1) for k, c in enumerate(cell))
            dense = x + resolution * y + resolution**2 * z
            hashed = (x ^ y * 2654435761 % 2**32 ^ z * 805459861 % 2**32) % 2**15
            assert index == (dense if level < 2 else hashed)


def test_trilinear_weights_interpolate_a_linear_function() -> None:
    points = np.vstack([np.random.default_rng(0).random((50, 3)), np.zeros(3), np.ones(3)])
    settings = CacheSettings()
    for level in (0, 1):
        n = settings.resolutions()[level]
        vertices = np.arange(n**3)
        values = vertices % n + 10.0 * (vertices // n % n) - 3.0 * (vertices // n**2)
        read = (values[level_indices(settings, points, level)] * level_weights(settings, points, level)).sum(1)
        np.testing.assert_allclose(read, points * (n - 1) @ [1.0, 10.0, -3.0], rtol=0, atol=1e-9)


def test_outside_the_box_nothing_moves_and_nothing_is_learnt() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    cache.set_weights(strong_weights(cache))
    means, quaternions = gaussians(40)
    means[::2] += np.float32(10)
    cache.place(means, quaternions)
    moved, turned = cache.moved()
    np.testing.assert_array_equal(moved[::2], means[::2])
    units = quaternions / np.linalg.norm(quaternions.astype(np.float64), axis=1, keepdims=True)
    np.testing.assert_array_equal(turned[::2], units.astype(np.float32)[::2])
    assert (moved[1::2] != means[1::2]).all()
    v_means, v_quaternions = np.zeros((40, 3), np.float32), np.zeros((40, 4), np.float32)
    v_means[::2] = v_quaternions[::2] = 1.0
    cache.backward(v_means, v_quaternions)
    for gradient in arrays(cache.gradients()):
        np.testing.assert_array_equal(gradient, 0)


def test_the_faces_of_the_box_belong_to_it() -> None:
    cache = TransformationCache([0, 0, 0], [1, 1, 1], SMALL, seed=0)
    cache.set_weights(strong_weights(cache))
    corners = np.array([[0, 0, 0], [1, 1, 1], [0, 1, 0.5], [1, 0, 1.0000001]], np.float32)
    cache.place(corners, np.ones((4, 4), np.float32))
    np.testing.assert_array_equal((cache.moved()[0] != corners).all(axis=1), [True, True, True, False])


@pytest.mark.parametrize("far", [False, True])
def test_a_frame_without_gaussians_to_move_changes_nothing(far: bool) -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    before = cache.digest()
    means = np.full((3 if far else 0, 3), 99, np.float32)
    cache.place(means, np.ones((len(means), 4), np.float32))
    moved, turned = cache.moved()
    np.testing.assert_array_equal(moved, means)
    cache.backward(moved, turned)
    cache.step()
    assert cache.digest() == before


# -- training ---------------------------------------------------------------------------------------------------------


def whole_table_adam(settings: CacheSettings, history: list[CacheWeights], start: CacheWeights) -> list[F64]:
    """Adam (Kingma 2015) in float64 over every weight, read or not."""
    values = [a.astype(np.float64) for a in arrays(start)]
    first, second = ([np.zeros_like(v) for v in values] for _ in range(2))
    for count, gradients in enumerate(history, 1):
        for value, m, v, g32 in zip(values, first, second, arrays(gradients), strict=True):
            g = g32.astype(np.float64)
            m += (1 - settings.beta1) * (g - m)
            v += (1 - settings.beta2) * (g * g - v)
            m_hat, v_hat = m / (1 - settings.beta1**count), v / (1 - settings.beta2**count)
            value -= settings.learning_rate * m_hat / (np.sqrt(v_hat) + settings.epsilon)
    return values


def test_training_the_entries_read_equals_an_adam_over_the_whole_table() -> None:
    """Also across a second placement in mid-frame. Tolerance: float32 moments leave about 1e-6 of a step of 2e-3 x 20,
    plus one rounding of the value per step."""
    settings = replace(SMALL, learning_rate=1e-2)
    cache = TransformationCache(LOW, HIGH, settings, seed=0)
    start = strong_weights(cache)
    cache.set_weights(start)
    means, quaternions = gaussians(90)
    history = []
    rng = np.random.default_rng(2)
    for count in (30, 90):
        cache.place(means[:count], quaternions[:count], same_frame=True)
        for _ in range(10):
            moved, _ = cache.moved()
            cache.backward(moved, rng.normal(size=(count, 4)).astype(np.float32))
            history.append(cache.gradients())
            cache.step()
    read = history[-1].grid != 0
    assert 0.02 < read.mean() < 0.95  # the test means something: many entries are never read
    np.testing.assert_array_equal(cache.weights().grid[~read], start.grid[~read])
    for ours, theirs in zip(arrays(cache.weights()), whole_table_adam(settings, history, start), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=5e-6)


def test_gradients_of_several_views_add_up() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    cache.set_weights(strong_weights(cache))
    cache.place(*gaussians(50))
    v_means, v_quaternions = cache.moved()
    cache.backward(v_means, v_quaternions)
    once = arrays(cache.gradients())
    cache.backward(v_means, v_quaternions)
    for one, two in zip(once, arrays(cache.gradients()), strict=True):
        np.testing.assert_array_equal(two, one + one)
    cache.step()
    assert not any(g.any() for g in arrays(cache.gradients()))


def test_restart_returns_to_the_start_and_repeats_the_frame() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    fresh = cache.digest()
    cache.place(*gaussians(50))
    train(cache, 5)
    trained = cache.digest()
    assert trained != fresh
    cache.restart()
    assert cache.digest() == fresh
    train(cache, 5)
    assert cache.digest() == trained


def test_weights_carry_over_to_the_next_frame_when_not_restarted() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    means, quaternions = gaussians(50)
    cache.place(means, quaternions)
    train(cache, 5)
    before, moved = cache.digest(), cache.moved()
    cache.place(*gaussians(20, seed=8))
    assert cache.digest() == before
    cache.place(means, quaternions)
    for ours, theirs in zip(cache.moved(), moved, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.usefixtures("torch_threads")
def test_results_do_not_depend_on_any_thread_count() -> None:
    digests = set()
    for torch_threads, own in ((1, 1), (2, 1), (2, 2), (1, 3)):
        torch.set_num_threads(torch_threads)
        cache = TransformationCache(LOW, HIGH, replace(CacheSettings(), levels=6), seed=4, threads=own)
        cache.place(*gaussians(5000))
        train(cache, 4)
        digests.add(cache.digest())
        assert torch.get_num_threads() == torch_threads  # put back as it was
    assert len(digests) == 1


def test_seed_decides_the_start() -> None:
    one, two, other = (TransformationCache(LOW, HIGH, SMALL, seed=s).digest() for s in (1, 1, 2))
    assert one == two
    assert one != other


def test_zero_quaternions_stand_for_no_rotation() -> None:
    """As in the rasteriser; the cache's rotation then is the whole rotation, and the base gets no gradient."""
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    means, _ = gaussians(6)
    quaternions = np.zeros((6, 4), np.float32)
    quaternions[3:] = np.float32(3e38)
    cache.place(means, quaternions)
    moved, turned = cache.moved()
    np.testing.assert_array_equal(turned[:3], np.tile(np.float32([1, 0, 0, 0]), (3, 1)))
    np.testing.assert_array_equal(turned[3:], 0.5)
    _, v_base = cache.backward(moved, turned + np.float32(0.5))
    np.testing.assert_array_equal(v_base[:3], 0)
    cache.step()
    assert all(np.isfinite(v).all() for v in cache.moved())


def test_a_zero_rotation_from_the_network_is_the_identity() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    weights = cache.weights()
    cache.set_weights(replace(weights, biases=(*weights.biases[:-1], np.zeros(7, np.float32))))
    means, quaternions = gaussians(6)
    cache.place(means, quaternions)
    expected = quaternions / np.linalg.norm(quaternions.astype(np.float64), axis=1, keepdims=True)
    np.testing.assert_array_equal(cache.moved()[1], expected.astype(np.float32))
    cache.backward(np.zeros((6, 3), np.float32), np.ones((6, 4), np.float32))
    assert not any(g.any() for g in arrays(cache.gradients()))


@pytest.mark.parametrize("size", [1e-30, 1e20, 3e38, np.inf])
def test_huge_and_tiny_gradients_leave_finite_weights_that_still_learn(size: float) -> None:
    cache = TransformationCache(LOW, HIGH, CacheSettings(), seed=0)
    cache.place(*gaussians(300))
    for _ in range(3):
        moved, turned = cache.moved()
        cache.backward(np.full_like(moved, size), np.full_like(turned, -size))
        cache.step()
        assert all(np.isfinite(v).all() for v in cache.moved())
    assert all(np.isfinite(a).all() for a in arrays(cache.weights()))
    spoilt = cache.digest()
    train(cache, 1)
    assert cache.digest() != spoilt


def test_values_that_are_not_numbers_are_refused() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    means, quaternions = gaussians(5)
    with pytest.raises(TrainingError, match="not finite"):
        cache.place(means * np.float32(np.nan), quaternions)
    cache.place(means, quaternions)
    moved, turned = cache.moved()
    turned[0, 0] = np.nan
    with pytest.raises(TrainingError, match="not a number"):
        cache.backward(moved, turned)


def test_backward_belongs_to_the_last_moved() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    means, quaternions = gaussians(5)
    cache.place(means, quaternions)
    with pytest.raises(RuntimeError, match="moved"):
        cache.backward(means, quaternions)
    cache.moved()
    cache.backward(means, quaternions)
    cache.step()
    with pytest.raises(RuntimeError, match="moved"):
        cache.backward(means, quaternions)
    with pytest.raises(ValueError, match="cannot replace"):
        cache.rebase(means[:4], quaternions[:4])


def test_learns_a_rigid_motion() -> None:
    """500 points turned by 10 degrees and shifted, squared error, 150 steps at the default rate.

    Measured: 0.092 world units (rms) and 10 degrees become 0.0002 and 0.025 degrees; the bounds leave a factor of 5.
    """
    rng = np.random.default_rng(3)
    means = (rng.random((500, 3)) - 0.5).astype(np.float32)
    quaternions = rng.normal(size=(500, 4)).astype(np.float32)
    axis, angle = np.array([1.0, 2.0, 2.0]) / 3.0, np.deg2rad(10.0)
    turn = np.tile(np.r_[np.cos(angle / 2), np.sin(angle / 2) * axis], (500, 1))
    spun = np.cos(angle) * means + np.sin(angle) * np.cross(axis, means)
    spun += (1 - np.cos(angle)) * (means @ axis)[:, None] * axis
    target = spun + np.array([0.05, -0.03, 0.02])
    cache = TransformationCache([-1, -1, -1], [1, 1, 1], CacheSettings(), seed=0)
    cache.place(means, quaternions)
    turned_target = quaternion_product(cache.moved()[1].astype(np.float64), turn)
    for _ in range(150):
        moved, turned = cache.moved()
        cache.backward(
            (2 * (moved - target) / 500).astype(np.float32), (2 * (turned - turned_target) / 500).astype(np.float32)
        )
        cache.step()
    moved, turned = cache.moved()
    assert np.sqrt(((moved - target) ** 2).sum(1).mean()) < 1e-3
    cosines = np.abs((turned * turned_target).sum(1)).clip(0, 1)
    assert np.rad2deg(2 * np.arccos(cosines)).mean() < 0.125


# -- warm-up, settings, bookkeeping -----------------------------------------------------------------------------------


def test_warm_up_has_nothing_to_do_from_an_identity_start() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    before = cache.digest()
    assert cache.warm_up(gaussians(100)[0], iterations=3) == 0.0
    assert cache.digest() == before


def test_warm_up_brings_a_random_start_to_the_identity() -> None:
    settings = replace(SMALL, identity_start=False, grid_spread=0.1)
    cache = TransformationCache(LOW, HIGH, settings, seed=0)
    means, quaternions = gaussians(100)
    first = cache.warm_up(means, iterations=1, learning_rate=0.0)
    last = cache.warm_up(means, iterations=300, learning_rate=1e-3)
    assert last < 0.1 * first
    warmed = cache.digest()
    cache.place(means, quaternions)
    train(cache, 3)
    cache.restart()
    assert cache.digest() == warmed


def test_counts_its_parameters() -> None:
    """16^3 + 15 * 2^15 entries of 4 features; 64 to 64 to 64 to 7 with biases: 2 * 64 * 65 + 7 * 65."""
    cache = TransformationCache(LOW, HIGH, CacheSettings(), seed=0)
    head = 2 * 64 * 65 + 7 * 65
    count = (16**3 + 15 * 2**15) * 4 + head
    found = cache.parameters()
    assert (found.count, found.size, found.trained) == (count, 4 * count, head)
    cache.place(*gaussians(1))
    assert head < cache.parameters().trained <= head + 16 * 8 * 4


@pytest.mark.parametrize(
    "bad", [{"levels": 0}, {"learning_rate": float("nan")}, {"level_scale": 8.0}, {"features": 99}]
)
def test_settings_out_of_range_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="transformation cache"):
        CacheSettings(**bad)  # type: ignore[arg-type]


def test_an_empty_box_is_refused() -> None:
    with pytest.raises(UsageError, match="empty"):
        TransformationCache([0, 0, 0], [1, 0, 1], SMALL, seed=0)
    with pytest.raises(UsageError, match="threads"):
        TransformationCache(LOW, HIGH, SMALL, seed=0, threads=0)


def test_weights_of_other_settings_are_refused() -> None:
    cache = TransformationCache(LOW, HIGH, SMALL, seed=0)
    other = TransformationCache(LOW, HIGH, replace(SMALL, hidden_width=16), seed=0)
    with pytest.raises(ValueError, match="other settings"):
        cache.set_weights(other.weights())
