"""Metrics against plain twins, and against pictures whose figures are known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.bench.measures.metrics import mean_over, psnr, slope, square_error_map, ssim_map, total_variation
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel


def picture(seed: int, height: int = 24, width: int = 31) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def ssim_twin(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """SSIM by its definition, window by window, in float64; zero outside the picture."""
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets**2) / (2 * 1.5**2))
    window = np.outer(window, window) / window.sum() ** 2
    height, width, _ = a.shape
    x, y = (np.pad(p / 255.0, ((5, 5), (5, 5), (0, 0))) for p in (a, b))
    result = np.zeros(a.shape)
    for row in range(height):
        for column in range(width):
            for channel in range(3):
                p, q = (z[row : row + 11, column : column + 11, channel] for z in (x, y))
                mean_p, mean_q = (window * p).sum(), (window * q).sum()
                variance_p, variance_q = (window * p * p).sum() - mean_p**2, (window * q * q).sum() - mean_q**2
                covariance = (window * p * q).sum() - mean_p * mean_q
                above = (2 * mean_p * mean_q + 1e-4) * (2 * covariance + 9e-4)
                below = (mean_p**2 + mean_q**2 + 1e-4) * (variance_p + variance_q + 9e-4)
                result[row, column, channel] = above / below
    return result


def test_ssim_is_its_definition() -> None:
    a = picture(0)
    b = np.clip(a.astype(int) + np.random.default_rng(1).integers(-40, 41, a.shape), 0, 255).astype(np.uint8)
    # Both float64; sums of 121 products in another order, divided by at least C1 C2 = 9e-8 at a black border.
    np.testing.assert_allclose(ssim_map(a, b), ssim_twin(a, b), rtol=0, atol=1e-9)


def test_ssim_is_the_one_that_training_uses() -> None:
    a, b = picture(2), picture(3)
    planes = [np.ascontiguousarray(p.transpose(2, 0, 1).astype(np.float32) / np.float32(255)) for p in (a, b)]
    value, _ = CpuKernel(1).loss(*planes, l1_scale=0.0, ssim_scale=1.0)
    # The kernel's sums are float32: 2000 pixels, each to about 1e-6 of a value up to 2.
    assert value.sums[1] == pytest.approx(float((1 - ssim_map(a, b)).sum()), rel=1e-4)


def test_ssim_of_a_picture_with_itself_is_one() -> None:
    np.testing.assert_allclose(ssim_map(picture(4), picture(4)), 1, rtol=0, atol=1e-12)


def test_psnr_by_hand_in_a_region() -> None:
    recorded = np.full((4, 5, 3), 100, np.uint8)
    seen = recorded.copy()
    seen[0, 0] = 110  # 10 levels in one of twenty pixels
    errors = square_error_map(seen, recorded)
    assert psnr(errors) == pytest.approx(20 * np.log10(255 / 10) + 10 * np.log10(20))
    mask = np.zeros((4, 5), bool)
    mask[0, :2] = True
    assert psnr(errors, mask) == pytest.approx(20 * np.log10(255 / 10) + 10 * np.log10(2))
    assert psnr(errors, ~mask) == pytest.approx(120)
    assert psnr(errors, np.zeros((4, 5), bool)) is None


def test_darker_and_brighter_count_alike() -> None:
    """Bytes must not wrap around."""
    low, high = np.full((2, 2, 3), 3, np.uint8), np.full((2, 2, 3), 250, np.uint8)
    assert psnr(square_error_map(low, high)) == psnr(square_error_map(high, low))
    everywhere = np.ones((2, 2), bool)
    assert total_variation(low, high, everywhere) == total_variation(high, low, everywhere) == pytest.approx(247 / 255)


def test_a_clip_that_stays_has_no_variation() -> None:
    assert total_variation(picture(5), picture(5), np.ones((24, 31), bool)) == 0


def test_a_known_flicker_counts_where_it_is_static_only() -> None:
    before = np.full((4, 4, 3), 100, np.uint8)
    after = before.copy()
    after[0, 0] = (151, 100, 100)  # one static pixel, one of its channels, by 51 levels: 0.2
    after[3] = 255  # not static
    static = np.ones((4, 4), bool)
    static[3] = False
    assert total_variation(before, after, static) == pytest.approx(0.2 / (12 * 3))
    assert total_variation(before, after, np.zeros((4, 4), bool)) is None


def test_mean_over_a_region() -> None:
    values = np.arange(12.0).reshape(2, 2, 3)
    mask = np.array([[True, False], [False, False]])
    assert mean_over(values, mask) == 1.0
    assert mean_over(values, ~mask & False) is None


def test_the_slope_of_a_line_is_exact() -> None:
    frames = list(range(10, 40, 3))
    found = slope(frames, [30 - 0.025 * frame for frame in frames])
    assert found is not None
    assert found.per_100_frames == pytest.approx(-2.5)
    assert found.error == pytest.approx(0, abs=1e-9)


def test_the_slopes_error_is_the_textbooks() -> None:
    """Against numpy's covariance of the fit, which is scaled by the residuals over n - 2."""
    random = np.random.default_rng(0)
    frames = np.arange(30)
    values = 31 - 0.02 * frames + random.normal(0, 0.1, 30)
    coefficients, covariance = np.polyfit(frames, values, 1, cov=True)
    found = slope(list(frames), list(values))
    assert found is not None
    assert found.per_100_frames == pytest.approx(100 * coefficients[0])
    assert found.error == pytest.approx(100 * np.sqrt(covariance[0, 0]))


def test_two_frames_have_no_slope_with_an_error() -> None:
    assert slope([0, 1], [30, 31]) is None
