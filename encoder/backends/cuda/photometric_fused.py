"""L1 and SSIM on a CUDA device in four passes: the fast form of ``photometric``, its twin, which the tests compare.

Blurring with the window is separable: one pass along rows, one along columns that also differentiates SSIM by the three
blurred maps it depends on, and the same two passes back. Every program does one 16x16 tile of one channel. Tiles that
nobody wants are left out; the passes before the last one also do their neighbours, since a gradient reaches ten pixels
(Wang 2004; Kerbl 2023, equation 7).
"""

# mypy: disable-error-code="no-untyped-def,untyped-decorator"
# Triton compiles the functions below; their arguments are its pointers and constants.

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as functional
import triton
import triton.language as tl
from torch import Tensor

from .photometric import TAPS

TILE = 16
_WINDOW = [float(tap) for tap in TAPS / TAPS.sum()]


class FusedLoss:
    """The loss of pictures of one size, with its buffers on ``device``."""

    def __init__(self, width: int, height: int, device: torch.device) -> None:
        self._width, self._height = width, height
        self._columns, self._rows = -(-width // TILE), -(-height // TILE)
        self._taps = torch.tensor(_WINDOW, device=device)
        self._along_rows = torch.empty((4, 3, height, width), device=device)
        self._by_maps = torch.empty((3, 3, height, width), device=device)
        self._back_along_rows = torch.empty_like(self._by_maps)
        self._sums = torch.empty((2, 3, self._rows * self._columns), device=device)
        self._everywhere = torch.ones((self._rows, self._columns), dtype=torch.uint8, device=device)

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
        """Sums (2,) of L1 and of 1 - SSIM over the tiles ``wanted`` (rows, columns), and the whole loss's gradient.

        ``image`` (H, W, C >= 3) as the rasteriser leaves it; ``target`` (3, H, W). The gradient (H, W, 4), whose last
        plane is 0, is 0 outside ``wanted``.
        """
        tiles = self._everywhere if wanted is None else wanted.to(torch.uint8)
        grown = tiles if wanted is None else functional.max_pool2d(tiles[None].float(), 3, 1, 1)[0].to(torch.uint8)
        grid = (self._columns, self._rows, 3)
        size = (self._height, self._width)
        stride: dict[str, Any] = {"PIXEL": image.stride(1), "ROW": image.stride(0), "PLANE": image.stride(2)}
        gradient = torch.zeros((*size, 4), device=image.device)
        flags = {"WEIGHTED": l1_weight is not None, "FOCUSED": focus is not None}
        weight, seen = target if l1_weight is None else l1_weight, target if focus is None else focus
        if ssim_scale:
            _rows_pass[grid](image, target, seen, self._taps, grown, self._along_rows, *size, **stride, **flags)
            _ssim_pass[grid](
                self._along_rows, seen, self._taps, grown, tiles, self._by_maps, self._sums, ssim_scale, *size, **flags
            )
            _rows_back_pass[grid](self._by_maps, self._taps, grown, self._back_along_rows, *size)
        _gradient_pass[grid](
            image, target, weight, seen, self._back_along_rows, self._taps, tiles, gradient, self._sums, l1_scale,
            *size, **stride, **flags, SSIM=bool(ssim_scale),
        )  # fmt: skip
        if not ssim_scale:
            self._sums[1].zero_()
        return self._sums.sum((1, 2), dtype=torch.float64), gradient


@triton.jit
def _tile(height, width):
    y = tl.program_id(1) * 16 + tl.arange(0, 16)[:, None]
    x = tl.program_id(0) * 16 + tl.arange(0, 16)[None, :]
    return y, x, (y < height) & (x < width), tl.program_id(1) * tl.num_programs(0) + tl.program_id(0)


@triton.jit
def _rows_pass(image, target, focus, taps, grown, out, height, width,
               PIXEL: tl.constexpr, ROW: tl.constexpr, PLANE: tl.constexpr,
               WEIGHTED: tl.constexpr, FOCUSED: tl.constexpr):  # fmt: skip
    """Window sums along rows of a, b, a^2 + b^2 and ab, the pictures in focus."""
    y, x, inside, tile = _tile(height, width)
    if tl.load(grown + tile) == 0:
        return
    channel, area = tl.program_id(2), height * width
    a_sum = tl.zeros((16, 16), tl.float32)
    b_sum = tl.zeros((16, 16), tl.float32)
    squares = tl.zeros((16, 16), tl.float32)
    product = tl.zeros((16, 16), tl.float32)
    for k in tl.static_range(11):
        at = x + (k - 5)
        there = (y < height) & (at >= 0) & (at < width)
        a = tl.load(image + channel * PLANE + y * ROW + at * PIXEL, mask=there, other=0.0)
        b = tl.load(target + channel * area + y * width + at, mask=there, other=0.0)
        if FOCUSED:
            f = tl.load(focus + y * width + at, mask=there, other=0.0)
            a, b = f * a, f * b
        tap = tl.load(taps + k)
        a_sum += tap * a
        b_sum += tap * b
        squares += tap * (a * a + b * b)
        product += tap * (a * b)
    place = out + channel * area + y * width + x
    tl.store(place, a_sum, mask=inside)
    tl.store(place + 3 * area, b_sum, mask=inside)
    tl.store(place + 6 * area, squares, mask=inside)
    tl.store(place + 9 * area, product, mask=inside)


@triton.jit
def _ssim_pass(maps, focus, taps, grown, wanted, out, sums, scale, height, width,
               WEIGHTED: tl.constexpr, FOCUSED: tl.constexpr):  # fmt: skip
    """Window sums along columns, 1 - SSIM, and the loss's gradient by the blurred a, a^2 + b^2 and ab."""
    y, x, inside, tile = _tile(height, width)
    channel, area, tiles = tl.program_id(2), height * width, tl.num_programs(0) * tl.num_programs(1)
    if tl.load(grown + tile) == 0:
        tl.store(sums + (3 + channel) * tiles + tile, 0.0)
        return
    mean_a = tl.zeros((16, 16), tl.float32)
    mean_b = tl.zeros((16, 16), tl.float32)
    squares = tl.zeros((16, 16), tl.float32)
    product = tl.zeros((16, 16), tl.float32)
    for k in tl.static_range(11):
        at = y + (k - 5)
        there = (x < width) & (at >= 0) & (at < height)
        place = maps + channel * area + at * width + x
        tap = tl.load(taps + k)
        mean_a += tap * tl.load(place, mask=there, other=0.0)
        mean_b += tap * tl.load(place + 3 * area, mask=there, other=0.0)
        squares += tap * tl.load(place + 6 * area, mask=there, other=0.0)
        product += tap * tl.load(place + 9 * area, mask=there, other=0.0)
    means, both = mean_a * mean_a + mean_b * mean_b, mean_a * mean_b
    above_1, above_2 = 2 * both + 1e-4, 2 * (product - both) + 9e-4
    below_1, below_2 = means + 1e-4, squares - means + 9e-4
    below = below_1 * below_2
    similar = above_1 * above_2 / below
    weight = tl.full((16, 16), 1.0, tl.float32)
    if FOCUSED:
        weight = tl.load(focus + y * width + x, mask=inside, other=0.0)
    by = -scale * weight
    by_mean = 2 * mean_b * (above_2 - above_1) / below - similar * 2 * mean_a * (1 / below_1 - 1 / below_2)
    place = out + channel * area + y * width + x
    tl.store(place, by * by_mean, mask=inside)
    tl.store(place + 3 * area, -by * similar / below_2, mask=inside)
    tl.store(place + 6 * area, by * 2 * above_1 / below, mask=inside)
    counted = tl.where(inside, weight * (1 - similar), 0.0)
    total = tl.where(tl.load(wanted + tile) != 0, tl.sum(tl.sum(counted, 1), 0), 0.0)
    tl.store(sums + (3 + channel) * tiles + tile, total)


@triton.jit
def _rows_back_pass(maps, taps, grown, out, height, width):
    """The same window along rows over the three gradients: its transpose is itself."""
    y, x, inside, tile = _tile(height, width)
    if tl.load(grown + tile) == 0:
        return
    channel, area = tl.program_id(2), height * width
    for plane in tl.static_range(3):
        total = tl.zeros((16, 16), tl.float32)
        for k in tl.static_range(11):
            at = x + (k - 5)
            there = (y < height) & (at >= 0) & (at < width)
            value = tl.load(maps + (3 * plane + channel) * area + y * width + at, mask=there, other=0.0)
            total += tl.load(taps + k) * value
        tl.store(out + (3 * plane + channel) * area + y * width + x, total, mask=inside)


@triton.jit
def _gradient_pass(image, target, l1_weight, focus, maps, taps, wanted, gradient, sums, l1_scale, height, width,
                   PIXEL: tl.constexpr, ROW: tl.constexpr, PLANE: tl.constexpr,
                   WEIGHTED: tl.constexpr, FOCUSED: tl.constexpr, SSIM: tl.constexpr):  # fmt: skip
    """L1 and the gradient of both by the picture."""
    y, x, inside, tile = _tile(height, width)
    channel, area, tiles = tl.program_id(2), height * width, tl.num_programs(0) * tl.num_programs(1)
    if tl.load(wanted + tile) == 0:
        tl.store(sums + channel * tiles + tile, 0.0)
        return
    a = tl.load(image + channel * PLANE + y * ROW + x * PIXEL, mask=inside, other=0.0)
    b = tl.load(target + channel * area + y * width + x, mask=inside, other=0.0)
    weight = tl.full((16, 16), 1.0, tl.float32)
    if WEIGHTED:
        weight = tl.load(l1_weight + y * width + x, mask=inside, other=0.0)
    off = a - b
    tl.store(sums + channel * tiles + tile, tl.sum(tl.sum(tl.where(inside, weight * tl.abs(off), 0.0), 1), 0))
    sign = tl.where(off > 0, 1.0, tl.where(off < 0, -1.0, 0.0))
    total = l1_scale * weight * sign
    if SSIM:
        by_mean = tl.zeros((16, 16), tl.float32)
        by_squares = tl.zeros((16, 16), tl.float32)
        by_product = tl.zeros((16, 16), tl.float32)
        for k in tl.static_range(11):
            at = y + (k - 5)
            there = (x < width) & (at >= 0) & (at < height)
            place = maps + channel * area + at * width + x
            tap = tl.load(taps + k)
            by_mean += tap * tl.load(place, mask=there, other=0.0)
            by_squares += tap * tl.load(place + 3 * area, mask=there, other=0.0)
            by_product += tap * tl.load(place + 6 * area, mask=there, other=0.0)
        f = tl.full((16, 16), 1.0, tl.float32)
        if FOCUSED:
            f = tl.load(focus + y * width + x, mask=inside, other=0.0)
        total += f * (by_mean + 2 * f * a * by_squares + f * b * by_product)
    tl.store(gradient + (y * width + x) * 4 + channel, total, mask=inside)
