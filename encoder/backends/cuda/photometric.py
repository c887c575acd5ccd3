"""L1 and SSIM of pictures on a torch device: the twin of kernel/loss.h for pictures that do not leave the device.

Chosen: the whole picture, and automatic differentiation. Rejected: a convolution for the window (a GPU would round it
to TF32 by default, which SSIM's small differences of large sums do not bear). Not tried: the wanted tiles alone.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

TAPS = np.exp(-(np.arange(-5, 6) ** 2) / 4.5)
"""Wang 2004: 11 x 11 Gaussian window of sigma 1.5, not yet of sum 1."""


def photometric_loss(
    image: Tensor,
    target: Tensor,
    l1_weight: Tensor | None,
    focus: Tensor | None,
    *,
    wanted: Tensor,
    l1_scale: float,
    ssim_scale: float,
) -> tuple[Tensor, Tensor]:
    """Sums (2,) of L1 and of 1 - SSIM, weighted, over the pixels ``wanted`` (H, W), float64.

    And the gradient (3, H, W) of ``TrainingKernel.picture_loss``, of the whole picture.
    """
    image = image.detach().requires_grad_()
    l1, dissimilarity = (image - target).abs(), torch.zeros_like(image)
    if l1_weight is not None:
        l1 = l1_weight * l1
    if ssim_scale and focus is None:
        dissimilarity = _dissimilarity(image, target)
    elif ssim_scale and focus is not None:
        dissimilarity = focus * _dissimilarity(focus * image, focus * target)
    (gradient,) = torch.autograd.grad(l1_scale * l1.sum() + ssim_scale * dissimilarity.sum(), image)
    sums = [(part.detach() * wanted).sum(dtype=torch.float64) for part in (l1, dissimilarity)]
    return torch.stack(sums), gradient


def _dissimilarity(a: Tensor, b: Tensor) -> Tensor:
    """1 - SSIM of pictures (3, H, W)."""
    mean_a, mean_b, squares, product = _blur(torch.stack([a, b, a * a + b * b, a * b]))
    means, both = mean_a * mean_a + mean_b * mean_b, mean_a * mean_b
    above: Tensor = (2 * both + 1e-4) * (2 * (product - both) + 9e-4)
    below: Tensor = (means + 1e-4) * (squares - means + 9e-4)
    return 1 - above / below


def _blur(planes: Tensor) -> Tensor:
    """Means over the window, zero outside the picture."""
    for axis, padding in ((-1, (5, 5)), (-2, (0, 0, 5, 5))):
        padded, size = functional.pad(planes, padding), planes.shape[axis]
        planes = torch.zeros_like(planes)
        for k, tap in enumerate(TAPS / TAPS.sum()):
            planes = planes + float(tap) * padded.narrow(axis, k, size)
    return planes


class TiledLoss:
    """The loss of pictures of one size, called as the fused one (``photometric_fused.FusedLoss``) is."""

    def __init__(self, width: int, height: int, device: torch.device) -> None:
        self._height, self._width = height, width

    def __call__(
        self,
        image: Tensor,
        target: Tensor,
        l1_weight: Tensor | None,
        focus: Tensor | None,
        *,
        wanted: Tensor | None,
        l1_scale: float,
        ssim_scale: float,
    ) -> tuple[Tensor, Tensor]:
        pixels = torch.ones((self._height, self._width), dtype=torch.bool, device=image.device)
        if wanted is not None:
            grown = wanted.repeat_interleave(16, 0).repeat_interleave(16, 1)
            pixels = grown[: self._height, : self._width]
        planar = image[..., :3].permute(2, 0, 1)
        sums, gradient = photometric_loss(
            planar, target, l1_weight, focus, wanted=pixels, l1_scale=l1_scale, ssim_scale=ssim_scale
        )
        return sums, functional.pad(gradient.permute(1, 2, 0), (0, 1))
