"""A stand-in for gsplat, the CUDA backend on it and on a GPU, and how near both must be to the native kernel.

On the CPU the stand-in for gsplat's four functions, brute force in torch, lets everything of ours run. Whatever gsplat
leaves undefined, it fills with NaN.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import rasterise_cases as cases
from decogs.encoder.backends import Gradients
from decogs.encoder.backends.cuda.cuda_kernel import CudaKernel
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.geometry.spherical_harmonics import sh_basis
from decogs.formats.splats import Splats

RATES = LearningRates(0.01, 0.01, 0.01, 0.01, 0.01, 0.01)
FIELDS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view")
CAMERA = cases.pinhole(83, 61, 70.0)
THRESHOLD = 1 / 255
"""Where alpha is at gsplat's and our threshold, rounding decides whether a contribution of this size is drawn."""


class StandIn:
    """gsplat's functions as their documentation has them, for one camera, in float64 inside.

    ``alpha_max`` is ours, so that differences are not gsplat's; one test takes gsplat's.
    """

    def __init__(self, alpha_max: float = 0.99) -> None:
        self.alpha_max = alpha_max
        self.tiles_drawn = 0

    def fully_fused_projection(
        self,
        means: Tensor,
        covars: None,
        quats: Tensor,
        scales: Tensor,
        viewmats: Tensor,
        Ks: Tensor,
        width: int,
        height: int,
        eps2d: float = 0.3,
        near_plane: float = 0.01,
        packed: bool = False,
        calc_compensations: bool = False,
        opacities: Tensor | None = None,
    ) -> tuple[Tensor, ...]:
        count = len(means)
        assert count > 0, "a division by zero in gsplat 1.5.3, which ends the process"
        assert covars is None
        assert calc_compensations
        assert opacities is not None
        assert not packed
        shapes = [tuple(x.shape) for x in (means, quats, scales, viewmats, Ks, opacities)]
        assert shapes == [(count, 3), (count, 4), (count, 3), (1, 4, 4), (1, 3, 3), (count,)]
        assert all(x.dtype == torch.float32 for x in (means, quats, scales, viewmats, Ks, opacities))
        means, quats, scales, pose, lens = (x.double() for x in (means, quats, scales, viewmats[0], Ks[0]))
        position = means @ pose[:3, :3].T + pose[:3, 3]
        z = position[:, 2]
        size, focal, centre = torch.tensor([width, height]), lens.diagonal()[:2], lens[:2, 2]
        rays = position[:, :2] / z[:, None]
        held = rays.clamp((-0.15 * size - centre) / focal, (1.15 * size - centre) / focal)
        slope = torch.cat([torch.diag_embed((1 / z)[:, None] * focal), (-held * focal / z[:, None])[:, :, None]], 2)
        half = slope @ pose[:3, :3] @ rotation_matrices(quats, torch) * scales[:, None]
        plain = half @ half.transpose(1, 2)
        filtered = plain + eps2d * torch.eye(2)
        compensations = (plain.det() / filtered.det()).clamp(min=0).sqrt()
        inverse = filtered.inverse()
        peak = opacities.double() * compensations.detach()
        reach = (2 * (peak / THRESHOLD).clamp(min=1).log()).sqrt()
        radii = (reach[:, None] * filtered.diagonal(dim1=1, dim2=2).sqrt()).ceil().detach()
        means2d = rays * focal + centre
        drawn = (z >= near_plane) & (peak >= THRESHOLD) & (means2d + radii > 0).all(1) & (means2d - radii < size).all(1)
        conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)

        def left_open(values: Tensor) -> Tensor:
            kept = drawn if values.ndim == 1 else drawn[:, None]
            return torch.where(kept, values, torch.nan).float()[None]

        radii = torch.where(drawn[:, None], radii, 0).int()[None]
        compensations = torch.where(drawn, compensations, 0.0).float()[None]
        return radii, left_open(means2d), left_open(z), left_open(conics), compensations

    def spherical_harmonics(self, degrees_to_use: int, dirs: Tensor, coeffs: Tensor) -> Tensor:
        count = len(dirs)
        assert dirs.shape == (count, 3)
        assert coeffs.shape[::2] == (count, 3)
        assert coeffs.shape[1] >= (degrees_to_use + 1) ** 2
        basis = sh_basis(torch, degrees_to_use, dirs / dirs.norm(dim=1, keepdim=True))
        return (basis[:, :, None] * coeffs[:, : basis.shape[1]]).sum(1)

    @torch.no_grad()
    def isect_tiles(
        self, means2d: Tensor, radii: Tensor, depths: Tensor, tile_size: int, tile_width: int, tile_height: int
    ) -> tuple[Tensor, Tensor, Tensor]:
        count = means2d.shape[1]
        assert (means2d.shape, radii.shape, depths.shape) == ((1, count, 2), (1, count, 2), (1, count))
        assert (means2d.dtype, radii.dtype, depths.dtype) == (torch.float32, torch.int32, torch.float32)
        bits = depths[0].contiguous().view(torch.int32).long() & 0xFFFFFFFF
        pairs = []
        for i in (radii[0] > 0).all(1).nonzero()[:, 0].tolist():
            low = ((means2d[0, i] - radii[0, i]) / tile_size).floor().long().clamp(min=0)
            high = ((means2d[0, i] + radii[0, i]) / tile_size).ceil().long()
            for y in range(int(low[1]), min(int(high[1]), tile_height)):
                for x in range(int(low[0]), min(int(high[0]), tile_width)):
                    pairs.append(((y * tile_width + x) << 32 | int(bits[i]), i))  # noqa: PERF401
        pairs.sort()
        keys, ids = torch.tensor([k for k, _ in pairs]).long(), torch.tensor([i for _, i in pairs]).int()
        return torch.bincount(ids, minlength=count)[None], keys, ids

    def isect_offset_encode(self, isect_ids: Tensor, n_images: int, tile_width: int, tile_height: int) -> Tensor:
        assert n_images == 1
        begins = torch.searchsorted(isect_ids >> 32, torch.arange(tile_width * tile_height))
        return begins.int().view(1, tile_height, tile_width)

    def rasterize_to_pixels(
        self,
        means2d: Tensor,
        conics: Tensor,
        colors: Tensor,
        opacities: Tensor,
        image_width: int,
        image_height: int,
        tile_size: int,
        isect_offsets: Tensor,
        flatten_ids: Tensor,
        backgrounds: None = None,
        masks: Tensor | None = None,
    ) -> tuple[Tensor, Tensor]:
        count, channels = colors.shape[1:]
        shapes = [tuple(x.shape) for x in (means2d, conics, colors, opacities)]
        assert shapes == [(1, count, 2), (1, count, 3), (1, count, channels), (1, count)]
        assert channels in (1, 2, 3, 4, 5, 8, 9, 16)
        assert masks is None or (masks.dtype == torch.bool and masks.shape == isect_offsets.shape)
        _, rows, columns = isect_offsets.shape
        ends = [*isect_offsets.flatten().tolist()[1:], len(flatten_ids)]
        # Nothing of a tile that is masked out is defined but its colours: their gradients must not matter either.
        bands = []
        for row in range(rows):
            tiles = []
            for column in range(columns):
                tile = row * columns + column
                if masks is not None and not masks[0, row, column]:
                    blank = torch.zeros(tile_size, tile_size, channels + 1)
                    blank[..., channels] = torch.nan
                    tiles.append(blank)
                    continue
                self.tiles_drawn += 1
                ids = flatten_ids[isect_offsets[0, row, column] : ends[tile]].long()
                chosen = (means2d[0, ids], conics[0, ids], colors[0, ids], opacities[0, ids])
                corner = torch.tensor([column * tile_size, row * tile_size])
                tiles.append(self._tile(corner, tile_size, *(x.double() for x in chosen)).float())
            bands.append(torch.cat(tiles, 1))
        planes = torch.cat(bands)[:image_height, :image_width]
        return planes[None, ..., :channels], planes[None, ..., channels:]

    def _tile(
        self, corner: Tensor, size: int, means2d: Tensor, conics: Tensor, colors: Tensor, opacities: Tensor
    ) -> Tensor:
        """Colours and alpha of a tile's pixels: Kerbl 2023, equation 3, for all pixels and all Gaussians at once."""
        y, x = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
        dx, dy = torch.stack([x, y], -1)[:, :, None].sub(means2d - corner).unbind(-1)
        fall = 0.5 * (conics[:, 0] * dx * dx + conics[:, 2] * dy * dy) + conics[:, 1] * dx * dy
        alpha = (opacities * (-fall).exp()).clamp(max=self.alpha_max)
        alpha = torch.where(alpha >= THRESHOLD, alpha, 0.0)
        after = (1 - alpha).cumprod(2)
        alpha = torch.where(after > 1e-4, alpha, 0.0)
        through = (1 - alpha).cumprod(2)
        before = torch.cat([torch.ones(size, size, 1), through], 2)
        return torch.cat([(alpha * before[:, :, :-1]) @ colors, 1 - before[:, :, -1:]], 2)


@dataclass(frozen=True)
class Backend:
    """A kernel under test and how far it may be from the native one.

    ``picture``: of a pixel, relative to the largest value. ``gradient``: of an attribute's gradients, length of the
    difference relative to their own length.
    """

    make: Callable[[], CudaKernel]
    picture: float
    gradient: float


BACKENDS = {
    # The stand-in is exact; what is left is float32 in between and in the native kernel (seen: 2e-6 and 6e-6).
    "stand-in": Backend(lambda: CudaKernel(device="cpu", gsplat=StandIn()), 1e-5, 3e-5),
    # gsplat compiles with fast maths and takes determinants as differences, which loses two digits of seven for an
    # ellipse ten times as long as wide; its compensation's gradient divides by the square root of one. Seen on an H100
    # with 150 000 Gaussians: 2.5e-6 (rms) and 3e-4.
    "gsplat": Backend(lambda: CudaKernel(), 1e-3, 2e-2),
}


def small_scene(seed: int, count: int = 120, degree: int = 1) -> Splats:
    scene: Splats = cases.scene(seed, count, degree, sigma=(0.02, 0.08))
    return scene


def assert_same_picture(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Up to ``tolerance``; two pixels in a thousand may have a Gaussian more or less at the threshold of alpha."""
    largest = max(1.0, float(np.abs(expected).max()))
    off = np.abs(actual - expected)
    assert off.shape == expected.shape
    assert off.max() <= 1.1 * THRESHOLD * largest
    assert (off > tolerance * largest).mean() <= 0.002


def assert_same_gradients(given: Gradients, wanted_ones: Gradients, tolerance: float) -> None:
    actual, expected = given.host(), wanted_ones.host()
    for name in FIELDS:
        found, wanted = getattr(actual, name), getattr(expected, name)
        assert np.isfinite(found).all(), name
        assert np.linalg.norm(found - wanted) <= tolerance * np.linalg.norm(wanted), name
        assert (found[(expected.view == 0) & (actual.view == 0)] == 0).all(), name
