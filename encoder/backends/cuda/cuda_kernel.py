"""The backend of a CUDA device: what is trained, drawn and compared stays there; the host reads what it asks for.

Chosen: gradients go back in two steps, through the compositing of all Gaussians and through the projection of the
changing ones alone. Losses, gradients and stepped values are handed on unread, so that a step waits for nothing but
gsplat, whose ``isect_tiles`` reads the number of its pairs.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats, sh_degree_of, take_splats

from ..arguments import check_cotangents
from ..protocol import ATTRIBUTES, BLACK, Colour, Drawable, LossValue, SplatGradients
from .device import Resident, read, read_floats, upload
from .fixed_view import CudaFixedView
from .gradients import CudaViewGradients, DeviceGradients
from .optimiser import CudaOptimiser
from .photometric import TiledLoss
from .projection import DEPTH, Lens, Projected, Splatting, back_to

LossMaker = Callable[[int, int, torch.device], Any]
"""Makes the loss of pictures of a width and height on a device: ``photometric.TiledLoss``, or the fused one."""


def _loss_on(device: torch.device) -> LossMaker:
    """The fused loss where there is a GPU, its readable twin elsewhere."""
    if device.type != "cuda":
        return TiledLoss
    from .photometric_fused import FusedLoss

    return FusedLoss


class DevicePicture:
    """A picture on the device; a plane travels when it is first asked for."""

    def __init__(self, rgb: Tensor, alpha: Tensor, depth: Tensor | None) -> None:
        self._rgb, self._alpha, self._depth = rgb, alpha, depth

    @cached_property
    def rgb(self) -> FloatArray:
        return read_floats(self._rgb.permute(2, 0, 1))

    @cached_property
    def alpha(self) -> FloatArray:
        return read_floats(self._alpha[..., 0])

    @cached_property
    def depth(self) -> FloatArray | None:
        return None if self._depth is None else read_floats(self._depth)


class _Drawn(NamedTuple):
    """The last picture, and its way back."""

    leaves: list[Tensor]
    projected: Projected
    inputs: Projected
    rgb: Tensor
    alphas: Tensor
    depths: Tensor


class CudaKernel:
    """``TrainingKernel`` on a torch ``device``.

    ``gsplat`` stands in for the module of that name: the tests run this class on the processor.
    """

    def __init__(self, background: Colour = BLACK, *, device: str = "cuda", gsplat: Any = None) -> None:
        self.background = background
        self.device = torch.device(device)
        self.splatting = Splatting(gsplat or importlib.import_module("gsplat"), self.device)
        self._loss_maker = _loss_on(self.device)
        self._losses: dict[tuple[int, int], Any] = {}
        self._arrays = Resident(self.upload)
        self._lenses = Resident(partial(Lens, device=self.device))
        self._drawn: _Drawn | None = None
        self._gradient: Tensor | None = None
        self._part: tuple[Splats, RowArray, list[Tensor]] | None = None

    def forward(
        self,
        splats: Drawable,
        camera: Camera,
        background: Colour | None = None,
        *,
        sh_degree: int | None = None,
        depth: bool = False,
    ) -> DevicePicture:
        lens, leaves = self._lenses.of(camera), self.leaves(splats)
        projected = self.splatting.project(leaves, lens, degree_of(leaves, sh_degree))
        inputs = projected.leaves()
        colours, alphas = self.splatting.composite(inputs, lens, self.splatting.tile_lists(projected, lens))
        rgb, depths = colours[..., :3], colours[..., DEPTH]
        rgb = self.over_background(rgb, alphas, background or self.background)
        self._drawn, self._gradient = _Drawn(leaves, projected, inputs, rgb, alphas, depths), None
        return DevicePicture(rgb.detach(), alphas.detach(), depths.detach() if depth else None)

    def over_background(self, rgb: Tensor, alphas: Tensor, background: Colour) -> Tensor:
        """Colours (H, W, 3) over ``background``."""
        return rgb + (1 - alphas) * self.upload(np.array(background, np.float32)) if any(background) else rgb

    def picture_loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        if self._drawn is None:
            raise ValueError("picture_loss needs a forward before it")
        given = [None if a is None else self._arrays.of(a) for a in (target, l1_weight, focus)]
        value, gradient = self.loss_of(self._drawn.rgb.detach(), given, None, l1_scale, ssim_scale)
        self._gradient = gradient[..., :3]
        return value

    def loss_of(
        self, image: Tensor, given: list[Tensor | None], wanted: Tensor | None, l1_scale: float, ssim_scale: float
    ) -> tuple[LossValue, Tensor]:
        """The loss of ``image`` (H, W, C >= 3) against target, weight of L1 and focus, all on the device.

        Summed over the tiles ``wanted`` (rows, columns), or all; with its gradient (H, W, 4).
        """
        size = (image.shape[1], image.shape[0])
        if size not in self._losses:
            self._losses[size] = self._loss_maker(*size, self.device)
        sums, gradient = self._losses[size](image, *given, wanted=wanted, l1_scale=l1_scale, ssim_scale=ssim_scale)
        return LossValue(l1_scale, ssim_scale, lambda: read(sums).tolist()), gradient

    def backward(
        self,
        splats: Drawable,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> DeviceGradients | SplatGradients:
        drawn = self._last(len(splats))
        if v_rgb is not None:
            check_cotangents((drawn.rgb.shape[0], drawn.rgb.shape[1]), v_rgb, v_alpha, v_depth)
        cotangent = self._gradient if v_rgb is None else self.upload(v_rgb).permute(1, 2, 0)
        if cotangent is None:
            raise ValueError("backward needs a cotangent, or the loss of the last picture")
        outputs, cotangents = [drawn.rgb], [cotangent]
        if v_alpha is not None:
            outputs, cotangents = [*outputs, drawn.alphas], [*cotangents, self.upload(v_alpha)[..., None]]
        if v_depth is not None:
            outputs, cotangents = [*outputs, drawn.depths], [*cotangents, self.upload(v_depth)]
        found = drawn.projected.gradients(drawn.leaves, back_to(drawn.inputs, outputs, cotangents))
        return found if out is None else found.put_into(out)

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        projected = self._last(count).projected
        nowhere = torch.where(projected.drawn, 0.0, torch.nan)
        return read_floats(projected.means2d + nowhere[:, None]), read_floats(projected.depths + nowhere)

    def fixed_view(self, camera: Camera) -> CudaFixedView:
        return CudaFixedView(self, camera)

    def optimiser(self, splats: Splats, *, beta1: float = 0.9, beta2: float = 0.999) -> CudaOptimiser:
        return CudaOptimiser(splats, self.device, beta1=beta1, beta2=beta2)

    def view_gradients(self, count: int) -> CudaViewGradients:
        return CudaViewGradients(count, self.device)

    def upload(self, values: NDArray[Any]) -> Tensor:
        """A copy on the device."""
        return upload(values, self.device)

    def leaves(self, drawn: Drawable) -> list[Tensor]:
        """Stored values on the device, ready to be differentiated by: an optimiser's in place, others travel."""
        if isinstance(drawn, CudaOptimiser):
            return [drawn.values[name].detach().requires_grad_() for name in ATTRIBUTES]
        splats = drawn if isinstance(drawn, Splats) else drawn.splats
        return [self.upload(getattr(splats, name)).requires_grad_() for name in ATTRIBUTES]

    def part(self, scene: Splats, rows: RowArray) -> list[Tensor]:
        """Stored values of a scene's ``rows`` on the device; they travel once for all views that ask in a row."""
        if self._part is None or self._part[0] is not scene or self._part[1] is not rows:
            self._part = scene, rows, self.leaves(take_splats(scene, rows))
        return self._part[2]

    def _last(self, count: int) -> _Drawn:
        if self._drawn is None or count != len(self._drawn.leaves[0]):
            raise ValueError("the scene must be that of the last forward")
        return self._drawn


def degree_of(stored: list[Tensor], limit: int | None = None) -> int:
    """Degree of spherical harmonics of stored values, or the ``limit`` if that is lower."""
    degree = sh_degree_of(stored[-1].shape[1])
    return degree if limit is None else min(limit, degree)
