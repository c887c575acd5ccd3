"""Gaussians on a picture of a CUDA device: projection, lists by tile and compositing, through gsplat.

Signatures and conventions are gsplat 1.5.3's, the same in 1.5.0: ``fully_fused_projection`` (not packed),
``spherical_harmonics``, ``isect_tiles``, ``isect_offset_encode``, and ``rasterize_to_pixels`` with its tile ``masks``.
Rejected: gsplat's ``rasterization``, which projects and draws everything.

Differs from the native kernel: alpha ends at 0.999 instead of 0.99, a constant of gsplat's kernels, so that a pixel in
the core of a denser Gaussian is off by up to 0.009 of the contrast to what is behind it; the tiles met are those of a
Gaussian's box, some more than its ellipse's; needles a thousand times as long as wide are off by some 2e-3 (gsplat's
own twin on the CPU), since it takes determinants as differences; sums run in no fixed order, so that the same seed
gives other bits every time.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from decogs.decoder.rasterise.reference import BLUR, CLOSEST
from decogs.formats.cameras import Camera, camera_centre

from .device import upload
from .gradients import NAMES, DeviceGradients

_TILE_PIXELS = 16
_NEAREST = 1e-10
"""Stands for "in front of the camera" where a camera has no near plane; gsplat divides by the square of the depth."""
DEPTH = 3
"""Channel of the colours, after red, green and blue."""


class Lens:
    """A pinhole camera as gsplat reads it."""

    def __init__(self, camera: Camera, device: torch.device) -> None:
        intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
        self.width, self.height, self.near = camera.width, camera.height, max(camera.near, _NEAREST)
        self.columns, self.rows = -(-camera.width // _TILE_PIXELS), -(-camera.height // _TILE_PIXELS)
        self.pose = upload(camera.world_to_camera[None].astype(np.float32), device)
        self.intrinsics = upload(np.array([intrinsics], np.float32), device)
        self.centre = upload(camera_centre(camera).astype(np.float32), device)

    @cached_property
    def tile_of(self) -> Tensor:
        """The number of every pixel's tile, (H, W, 1)."""
        device = self.pose.device
        row, column = torch.arange(self.height, device=device), torch.arange(self.width, device=device)
        return ((row // _TILE_PIXELS)[:, None] * self.columns + (column // _TILE_PIXELS)[None])[..., None]

    def pixels(self, tiles: Tensor) -> Tensor:
        """Pixels (H, W, 1) of tiles (rows, columns)."""
        return tiles.view(-1)[self.tile_of]


class Projected(NamedTuple):
    """N Gaussians on a picture. One whose radii are 0 is not drawn; its other values mean nothing and may be NaN."""

    means2d: Tensor  # (N, 2) pixels
    conics: Tensor  # (N, 3)
    opacities: Tensor  # (N,) with the filter's compensation
    colours: Tensor  # (N, 4) red, green, blue, depth
    depths: Tensor  # (N,)
    radii: Tensor  # (N, 2) int32, half size of the box in pixels

    @classmethod
    def blank(cls, count: int, device: torch.device) -> Projected:
        """``count`` Gaussians that are not drawn."""
        values = [torch.zeros((count, *tail), device=device) for tail in ((2,), (3,), (), (4,), (), (2,))]
        return cls(*values)._replace(radii=values[-1].int())

    @property
    def drawn(self) -> Tensor:
        return (self.radii > 0).all(1)

    def take(self, rows: Tensor | slice) -> Projected:
        return Projected(*(values[rows] for values in self))

    def with_room(self, count: int) -> Projected:
        """These, and after them as many that are not drawn as make ``count``."""
        more = Projected.blank(count - len(self.radii), self.radii.device)
        return Projected(*(torch.cat(pair) for pair in zip(self, more, strict=True)))

    def write(self, rows: Tensor, others: Projected) -> None:
        """Puts ``others`` in place of ``rows``."""
        for mine, new in zip(self, others, strict=True):
            mine.index_copy_(0, rows, new.detach())

    def gradients(self, leaves: list[Tensor], by: Sequence[Tensor]) -> DeviceGradients:
        """Gradients of the stored values, ``leaves``, from those ``by`` these; exactly zero for what is not drawn."""
        found = torch.autograd.grad(self[:4], leaves, by, retain_graph=True) if len(leaves[0]) else leaves
        tensors = {}
        for name, gradient in zip(NAMES, (*found, by[0].norm(dim=1)), strict=True):
            mask = self.drawn.view(-1, *[1] * (gradient.ndim - 1))
            tensors[name] = torch.where(mask, gradient, 0.0).detach()
        return DeviceGradients(tensors)

    def leaves(self) -> Projected:
        """The same values, ready to be differentiated by."""
        floats = [values.detach().requires_grad_() for values in self[:4]]
        return Projected(floats[0], floats[1], floats[2], floats[3], self.depths, self.radii)


class Lists(NamedTuple):
    """Pairs of a tile and a Gaussian by tile, front to back; equal depths in the scene's order."""

    tiles: Tensor  # (P,)
    gaussians: Tensor  # (P,) int32
    offsets: Tensor  # (1, rows, columns) int32, where a tile's pairs begin


def back_to(inputs: Projected, outputs: Sequence[Tensor], cotangents: Sequence[Tensor]) -> list[Tensor]:
    """Gradients of what was composited by the projected values ``inputs``; zeros where nothing was."""
    if not any(output.requires_grad for output in outputs):
        return [torch.zeros_like(values) for values in inputs[:4]]
    return list(torch.autograd.grad(outputs, inputs[:4], cotangents, retain_graph=True))


class Splatting:
    """gsplat's functions on ``device``; ``gsplat`` stands in for the module of that name."""

    def __init__(self, gsplat: Any, device: torch.device) -> None:
        self._gsplat, self._device = gsplat, device

    def project(self, stored: Sequence[Tensor], lens: Lens, sh_degree: int) -> Projected:
        """Ellipses and colours of Gaussians by their stored values; conventions of kernel/project.h."""
        means, log_scales, quaternions, opacity_logits, sh = stored
        if not len(means):  # gsplat 1.5.3 divides by the number of Gaussians
            return Projected.blank(0, self._device)
        scales, opacities = log_scales.exp(), opacity_logits.sigmoid()
        radii, means2d, depths, conics, compensations = self._gsplat.fully_fused_projection(
            means,
            None,
            _turned_somehow(quaternions),
            scales,
            lens.pose,
            lens.intrinsics,
            lens.width,
            lens.height,
            eps2d=BLUR,
            near_plane=lens.near,
            packed=False,
            calc_compensations=True,
            opacities=opacities.detach(),
        )
        near_enough = depths[0].detach() >= CLOSEST * scales.detach().amax(1)
        rgb = (0.5 + self._gsplat.spherical_harmonics(sh_degree, means - lens.centre, sh)).relu()
        return Projected(
            means2d[0],
            conics[0],
            opacities * compensations[0],
            torch.cat([rgb, depths[0, :, None]], 1),
            depths[0].detach(),
            torch.where(near_enough[:, None], radii[0], 0),
        )

    def tile_lists(self, projected: Projected, lens: Lens) -> Lists:
        """Which tiles the Gaussians' boxes meet."""
        means2d, radii, depths = projected.means2d.detach()[None], projected.radii[None], projected.depths[None]
        _, keys, gaussians = self._gsplat.isect_tiles(means2d, radii, depths, _TILE_PIXELS, lens.columns, lens.rows)
        offsets = self._gsplat.isect_offset_encode(keys, 1, lens.columns, lens.rows)
        return Lists(keys >> 32, gaussians, offsets)  # a key: image (0, there is one), tile, 32 bits of depth

    def composite(
        self, projected: Projected, lens: Lens, lists: Lists, tiles: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Red, green, blue, depth (H, W, 4), alpha (H, W, 1); undefined outside ``tiles`` (rows, columns) if given."""
        colours, alphas = self._gsplat.rasterize_to_pixels(
            projected.means2d[None],
            projected.conics[None],
            projected.colours[None],
            projected.opacities[None],
            lens.width,
            lens.height,
            _TILE_PIXELS,
            lists.offsets,
            lists.gaussians,
            masks=None if tiles is None else tiles[None],
        )
        return colours[0], alphas[0]


def _turned_somehow(quaternions: Tensor) -> Tensor:
    """No rotation in place of a zero quaternion; gsplat brings the others to unit length."""
    zero = quaternions.detach().abs().amax(1, keepdim=True) < 1e-18
    upright = functional.pad(torch.ones_like(quaternions[:, :1]), (0, 3))  # made there: nothing travels
    return torch.where(zero, upright, quaternions)
