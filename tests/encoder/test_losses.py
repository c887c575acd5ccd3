"""The losses against the formulas written out in float64 with torch.

Sources: docs/METHOD.md, "Focus-aware loss"; Kerbl 2023, equation 7.

Tolerances: the kernel works in float32 and sums 6912 terms; values agree to 1e-5 relatively, and gradients, whose
largest is about 1e-4, to 1e-8 absolutely.
"""

from __future__ import annotations

import numpy as np
import pytest
import torch

from decogs.encoder.backends import LossValue
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.settings.frame import FocusWeights
from decogs.encoder.training.losses import PhotometricLoss, focus_loss, whole_picture_loss

HEIGHT, WIDTH = 36, 64
RANDOM = np.random.default_rng(5)
IMAGE = RANDOM.random((3, HEIGHT, WIDTH), np.float32)
TARGET = np.clip(IMAGE + RANDOM.normal(0, 0.1, IMAGE.shape), 0, 1).astype(np.float32)
MASK = np.zeros((HEIGHT, WIDTH), bool)
MASK[8:25, 20:50] = True
VALID = np.ones((HEIGHT, WIDTH), np.float32)
VALID[:, 44:] = 0


def ssim_map(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Wang 2004 with 3DGS's window: 11 x 11, sigma 1.5, zeros outside the picture."""
    taps = torch.exp(-((torch.arange(11, dtype=torch.float64) - 5) ** 2) / (2 * 1.5**2))
    window = torch.outer(taps / taps.sum(), taps / taps.sum()).expand(3, 1, 11, 11)

    def blurred(x: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.conv2d(x[None], window, padding=5, groups=3)[0]

    mean_a, mean_b = blurred(a), blurred(b)
    variance_a, variance_b = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2
    covariance = blurred(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    return ((2 * mean_a * mean_b + c1) * (2 * covariance + c2)) / (
        (mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2)
    )


def mean_over(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    return (values * weights).sum() / (3 * weights.sum())


def evaluated(loss: PhotometricLoss) -> tuple[LossValue, np.ndarray]:
    """The loss of IMAGE and its gradient."""
    scales = {"l1_scale": loss.l1_scale, "ssim_scale": loss.ssim_scale}
    return CpuKernel(1).loss(IMAGE, loss.target, **scales, l1_weight=loss.l1_weight, focus=loss.focus)


def check(loss: PhotometricLoss, expected: torch.Tensor, image: torch.Tensor) -> None:
    (gradient,) = torch.autograd.grad(expected, image)
    value, cotangent = evaluated(loss)
    assert value.total == pytest.approx(float(expected.detach()), rel=1e-5)
    np.testing.assert_allclose(cotangent, gradient.numpy(), rtol=1e-3, atol=1e-8)
    assert np.abs(cotangent).max() > 1e-5


@pytest.mark.parametrize("valid", [None, VALID])
@pytest.mark.parametrize(
    "weights",
    [
        FocusWeights(),
        FocusWeights(dissimilarity=0.3, whole=0.6, focus=0.5),
        FocusWeights(dissimilarity=0.3, over="picture"),
    ],
)
def test_focus_loss_is_the_formula_of_the_method(valid: np.ndarray | None, weights: FocusWeights) -> None:
    image = torch.tensor(IMAGE, dtype=torch.float64, requires_grad=True)
    target = torch.tensor(TARGET, dtype=torch.float64)
    counted = torch.ones(HEIGHT, WIDTH, dtype=torch.float64) if valid is None else torch.tensor(valid).double()
    focus = torch.tensor(MASK).double() * counted
    difference = (image - target).abs()
    lam = weights.dissimilarity
    share = focus.sum() / counted.sum() if weights.over == "picture" else 1
    expected = (1 - lam) * (
        weights.whole * mean_over(difference, counted) + share * weights.focus * mean_over(difference, focus)
    ) + share * lam * mean_over(1 - ssim_map(focus * image, focus * target), focus)
    check(focus_loss(TARGET, MASK, valid, weights), expected, image)


@pytest.mark.parametrize("counted", [None, VALID])
def test_whole_picture_loss_is_that_of_3dgs(counted: np.ndarray | None) -> None:
    image = torch.tensor(IMAGE, dtype=torch.float64, requires_grad=True)
    target = torch.tensor(TARGET, dtype=torch.float64)
    weights = torch.ones(HEIGHT, WIDTH, dtype=torch.float64) if counted is None else torch.tensor(counted).double()
    l1 = mean_over((image - target).abs(), weights)
    expected = 0.8 * l1 + 0.2 * mean_over(1 - ssim_map(weights * image, weights * target), weights)
    check(whole_picture_loss(TARGET, counted, 0.2), expected, image)


def test_pixels_that_were_not_recorded_count_for_nothing() -> None:
    poisoned = np.where(VALID == 0, np.float32(0.77), TARGET)
    for first, second in (
        (focus_loss(TARGET, MASK, VALID, FocusWeights()), focus_loss(poisoned, MASK, VALID, FocusWeights())),
        (whole_picture_loss(TARGET, VALID, 0.2), whole_picture_loss(poisoned, VALID, 0.2)),
    ):
        value, gradient = evaluated(first)
        value_poisoned, gradient_poisoned = evaluated(second)
        assert value.total == value_poisoned.total
        np.testing.assert_array_equal(gradient, gradient_poisoned)
        assert not gradient[:, VALID == 0].any()


def test_without_a_focus_the_l1_of_the_whole_remains() -> None:
    weights = FocusWeights(dissimilarity=0.2, whole=0.3, focus=0.9)
    loss = focus_loss(TARGET, np.zeros_like(MASK), None, weights)
    value, gradient = evaluated(loss)
    difference = IMAGE.astype(np.float64) - TARGET
    assert value.total == pytest.approx(0.8 * 0.3 * np.abs(difference).mean(), rel=1e-5)
    np.testing.assert_allclose(gradient, 0.8 * 0.3 * np.sign(difference) / IMAGE.size, rtol=1e-5)


def test_a_pixel_in_focus_outweighs_one_outside() -> None:
    weights = FocusWeights(dissimilarity=0.0, whole=0.2, focus=0.8)
    _, gradient = evaluated(focus_loss(TARGET, MASK, None, weights))
    inside, outside = np.abs(gradient[:, MASK]), np.abs(gradient[:, ~MASK])
    np.testing.assert_allclose(outside, 0.2 / IMAGE.size, rtol=1e-5)
    np.testing.assert_allclose(inside, 0.2 / IMAGE.size + 0.8 / (3 * MASK.sum()), rtol=1e-5)


@pytest.mark.parametrize("over", ["region", "picture"])
def test_emphasis_is_the_weight_of_a_pixel_in_focus_over_that_in_the_mean_of_the_picture(over: str) -> None:
    loss = focus_loss(TARGET, MASK, None, FocusWeights(dissimilarity=0.0, whole=0.2, focus=0.8, over=over))
    _, gradient = evaluated(loss)
    np.testing.assert_allclose(np.abs(gradient[:, MASK]) * IMAGE.size, loss.emphasis, rtol=1e-5)


def test_white_asks_for_white_and_no_less() -> None:
    """Nothing pulls a colour beyond white to a clipped pixel; what is recorded darker, or is drawn so, is pulled."""
    target = np.full((3, HEIGHT, WIDTH), 0.5, np.float32)
    target[:, :, 16:] = 253 / 255  # white, less noise
    rendered = np.full_like(target, 1.5)
    rendered[:, :, 48:] = 0.9
    loss = whole_picture_loss(target, None, 0.0).with_clipped(rendered)
    scales = {"l1_scale": loss.l1_scale, "ssim_scale": loss.ssim_scale}
    _, gradient = CpuKernel(1).loss(rendered, loss.target, **scales)
    assert (gradient[:, :, :16] > 0).all()
    assert (gradient[:, :, 16:48] == 0).all()
    assert (gradient[:, :, 48:] < 0).all()
