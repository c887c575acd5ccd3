"""The fused L1 + SSIM of the training kernel against torch in float64, values and gradients."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel

ROUNDING = 2.0**-24
GRADIENT = 60 * ROUNDING
"""Relative to the largest gradient; each is some sixty operations; seen: 10 roundings."""
SMOOTH_GRADIENT = 1000 * ROUNDING
"""The same for a smooth picture: a variance E[x^2] - E[x]^2 of nearly nothing keeps the roundings of its minuend, up to
a few times 1 against C2 = 9e-4 in the denominator, so some thousands in the worst pixel; seen: 370."""
VALUE = 150 * ROUNDING
"""Relative; where the picture is smooth the errors of neighbours are of one sign; seen: 66 roundings."""


def torch_loss(
    image: torch.Tensor,
    target: torch.Tensor,
    l1_scale: float,
    ssim_scale: float,
    l1_weight: torch.Tensor,
    focus: torch.Tensor,
) -> torch.Tensor:
    """Wang 2004 with 3DGS's window: 11 x 11 Gaussian of sigma 1.5, zero outside the picture."""
    taps = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / 4.5)
    window = torch.outer(taps, taps) / taps.sum() ** 2

    def blur(planes: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(planes[:, None], window[None, None], padding=5)[:, 0]

    a, b = image * focus, target * focus
    ma, mb = blur(a), blur(b)
    va, vb, vab = blur(a * a) - ma * ma, blur(b * b) - mb * mb, blur(a * b) - ma * mb
    ssim = (2 * ma * mb + 1e-4) * (2 * vab + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4))
    return l1_scale * (l1_weight * (image - target).abs()).sum() + ssim_scale * (focus * (1 - ssim)).sum()


def pictures(height: int, width: int, seed: int = 0, *, smooth: bool = False) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    image = rng.random((3, height, width))
    if smooth:
        image[0] = np.linspace(0, 1, height * width).reshape(height, width)
        image[1] = image[0, ::-1]
    target = np.clip(image + rng.normal(size=image.shape) * 0.1, 0, 1)
    return image.astype(np.float32), target.astype(np.float32)


def check(
    image: np.ndarray,
    target: np.ndarray,
    l1_scale: float,
    ssim_scale: float,
    l1_weight: np.ndarray | None = None,
    focus: np.ndarray | None = None,
    tolerance: float = GRADIENT,
) -> None:
    value, gradient = CpuKernel(2).loss(
        image, target, l1_scale=l1_scale, ssim_scale=ssim_scale, l1_weight=l1_weight, focus=focus
    )
    a = torch.tensor(image.astype(float), requires_grad=True)
    ones = np.ones(image.shape[1:])
    weights = [torch.tensor(ones if w is None else w.astype(float)) for w in (l1_weight, focus)]
    expected = torch_loss(a, torch.tensor(target.astype(float)), l1_scale, ssim_scale, *weights)
    expected.backward()
    assert value.total == pytest.approx(expected.item(), rel=VALUE, abs=1e-12)
    assert a.grad is not None
    reference = a.grad.numpy()
    assert np.isfinite(gradient).all()
    assert np.abs(gradient - reference).max() <= tolerance * np.abs(reference).max()


SIZES = [(1, 1), (1, 17), (11, 5), (16, 16), (50, 61), (63, 128), (64, 129), (65, 127), (130, 300)]


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(("l1_scale", "ssim_scale"), [(0.8, 0.2), (0.0, 1.0), (1.0, 0.0)])
def test_loss_is_torchs(size: tuple[int, int], l1_scale: float, ssim_scale: float) -> None:
    image, target = pictures(*size)
    check(image, target, l1_scale / image.size, ssim_scale / image.size)


@pytest.mark.parametrize("size", SIZES)
def test_smooth_pictures_are_torchs_too(size: tuple[int, int]) -> None:
    image, target = pictures(*size, smooth=True)
    check(image, target, 0.8 / image.size, 0.2 / image.size, tolerance=SMOOTH_GRADIENT)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("soft", [False, True])
def test_weighted_loss_is_torchs(size: tuple[int, int], soft: bool) -> None:
    image, target = pictures(*size, seed=1)
    rng = np.random.default_rng(2)
    focus = rng.random(size) if soft else rng.random(size) > 0.4
    focus[0, 0] = 1
    weight = rng.random(size) * 3
    check(image, target, 0.8 / image.size, 0.2 / image.size, weight.astype(np.float32), focus.astype(np.float32))


def test_each_weight_alone() -> None:
    image, target = pictures(37, 53)
    half = np.zeros((37, 53), np.float32)
    half[:, 20:] = 1
    check(image, target, 0.8 / image.size, 0.2 / image.size, l1_weight=half)
    check(image, target, 0.8 / image.size, 0.2 / image.size, focus=half)


def test_equal_pictures_cost_nothing() -> None:
    image, _ = pictures(40, 30)
    value, gradient = CpuKernel(1).loss(image, image.copy(), l1_scale=1.0, ssim_scale=1.0)
    # 1 - SSIM of equal pictures: rounding of the two products that should be equal, per pixel.
    assert abs(value.total) <= 20 * ROUNDING * image.size
    assert value.sums[0] == 0
    assert np.abs(gradient).max() < 1e-3  # against some 30 for pictures that differ by 0.1


def test_pictures_out_of_range_stay_finite() -> None:
    # Renders may exceed 1 before training settles; flat bright areas are where variances cancel worst.
    image, target = pictures(33, 47, smooth=True)
    bright = np.where(image > 0.5, np.float32(8.0), image)
    value, gradient = CpuKernel(1).loss(bright, target, l1_scale=0.8, ssim_scale=0.2)
    assert np.isfinite(value.total)
    assert np.isfinite(gradient).all()


def test_threads_and_given_gradient_change_no_bit() -> None:
    image, target = pictures(150, 141)
    first = CpuKernel(1).loss(image, target, l1_scale=0.8, ssim_scale=0.2)
    for threads in (2, 5):
        out = np.full_like(image, np.nan)
        value, gradient = CpuKernel(threads).loss(image, target, l1_scale=0.8, ssim_scale=0.2, gradient=out)
        assert gradient is out
        assert value.sums == first[0].sums
        np.testing.assert_array_equal(gradient, first[1])


def test_a_kernel_serves_one_size_after_another() -> None:
    kernel = CpuKernel(2)
    for size in ((130, 300), (1, 1), (64, 129), (11, 5)):
        image, target = pictures(*size)
        again = kernel.loss(image, target, l1_scale=0.8, ssim_scale=0.2)
        fresh = CpuKernel(1).loss(image, target, l1_scale=0.8, ssim_scale=0.2)
        assert again[0].sums == fresh[0].sums
        np.testing.assert_array_equal(again[1], fresh[1])


def test_shapes_that_do_not_fit_are_refused() -> None:
    image, target = pictures(8, 9)
    kernel = CpuKernel(1)
    with pytest.raises(ValueError, match="target"):
        kernel.loss(image, target[:, 1:], l1_scale=1, ssim_scale=1)
    with pytest.raises(ValueError, match="weights"):
        kernel.loss(image, target, l1_scale=1, ssim_scale=1, focus=np.ones((9, 8), np.float32))
    with pytest.raises(ValueError, match="gradient"):
        kernel.loss(image, target, l1_scale=1, ssim_scale=1, gradient=np.ones((3, 8, 8), np.float32))
    with pytest.raises(ValueError, match="float64"):
        kernel.loss(image.astype(np.float64), target.astype(np.float64), l1_scale=1, ssim_scale=1)
