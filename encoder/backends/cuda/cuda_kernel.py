"""The backend of a CUDA device: what is trained, drawn and compared stays there; the host reads what it asks for.

Losses, gradients and stepped values are handed on unread, so that a step waits for nothing. No sum depends on the order
in which threads come: the same seed gives the same bytes.
"""

from __future__ import annotations

from functools import cached_property, partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats, take_splats

from ..arguments import check_cotangents
from ..protocol import ATTRIBUTES, BLACK, Colour, Drawable, LossValue, SplatGradients
from .device import Resident, read_floats, upload
from .fixed_view import Committed, CudaFixedView
from .gradients import CudaViewGradients, DeviceGradients
from .module import CompiledKernels, Kernels
from .optimiser import CudaOptimiser
from .photometric import DeviceLoss
from .splatting import Drawn, Lens, Planes, Splatting, Stored, centres


class DevicePicture:
    """A picture on the device; a plane travels when it is first asked for."""

    def __init__(self, lens: Lens, planes: Planes, *, depth: bool) -> None:
        self._lens, self._planes, self._deep = lens, planes, depth

    @cached_property
    def rgb(self) -> FloatArray:
        return self._read(self._planes.rgb)

    @cached_property
    def alpha(self) -> FloatArray:
        return self._read(1 - self._planes.transmittance)

    @cached_property
    def depth(self) -> FloatArray | None:
        return self._read(self._planes.depth) if self._deep else None

    def _read(self, plane: Tensor) -> FloatArray:
        values = read_floats(plane)
        self._lens.room.check(self._lens.camera)
        return values


class CudaKernel:
    """``TrainingKernel`` on a torch ``device``, by its ``kernels``; the tests run this class on the processor."""

    leaves_processor_idle = True

    def __init__(self, background: Colour = BLACK, *, device: str = "cuda", kernels: Kernels | None = None) -> None:
        self.background = background
        self.device = torch.device(device)
        self.splatting = Splatting(kernels or CompiledKernels(self.device), self.device)
        self.compare = DeviceLoss(self.splatting.kernels, self.device)
        self._arrays = Resident(self.upload)
        self._lenses = Resident(partial(Lens, device=self.device))
        self._drawn: Drawn | None = None
        self._gradient: Tensor | None = None
        self._committed: tuple[tuple[Splats, RowArray, RowArray | None], Committed] | None = None

    def forward(
        self,
        splats: Drawable,
        camera: Camera,
        background: Colour | None = None,
        *,
        sh_degree: int | None = None,
        depth: bool = False,
        tiles: NDArray[np.uint8] | None = None,
    ) -> DevicePicture:
        """All ``tiles`` are drawn: what does not count in the loss has no gradient."""
        lens, stored = self._lenses.of(camera), self.stored(splats, sh_degree)
        self._drawn = self._gradient = None
        projected = self.splatting.project(stored, lens)
        planes = Planes(camera, self.device, background or self.background)
        lists = self.splatting.lists(projected, lens, None, None)
        self.splatting.composite(projected, lens, lists, planes)
        self._lens, self._drawn = lens, Drawn(stored, None, projected, lists, planes)
        return DevicePicture(lens, planes, depth=depth)

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
        given = self.brought(target, l1_weight, focus)
        value, self._gradient = self.compare(self._drawn.planes.rgb, given, None, l1_scale, ssim_scale)
        return value

    def bring(self, *arrays: FloatArray | None) -> None:
        self.brought(*arrays)

    def brought(self, *arrays: FloatArray | None) -> list[Tensor | None]:
        """The arrays' copies on the device."""
        return [None if array is None else self._arrays.of(array) for array in arrays]

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
            check_cotangents((self._lens.camera.height, self._lens.camera.width), v_rgb, v_alpha, v_depth)
        by = [None if plane is None else self.upload(plane) for plane in (v_rgb, v_alpha, v_depth)]
        by[0] = self._gradient if v_rgb is None else by[0]
        if by[0] is None:
            raise ValueError("backward needs a cotangent, or the loss of the last picture")
        moments = self.splatting.moments(drawn, self._lens, by)
        gradients = self.splatting.gradients(drawn, self._lens, moments)
        return gradients if out is None else gradients.put_into(out)

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        places, depths = centres(self._last(count).all)
        return read_floats(places), read_floats(depths)

    def fixed_view(self, camera: Camera, recorded: NDArray[np.bool_] | None = None) -> CudaFixedView:
        return CudaFixedView(self, camera, recorded)

    def optimiser(self, splats: Splats, *, beta1: float = 0.9, beta2: float = 0.999) -> CudaOptimiser:
        return CudaOptimiser(splats, self.splatting.kernels, self.device, beta1=beta1, beta2=beta2)

    def view_gradients(self, count: int) -> CudaViewGradients:
        return CudaViewGradients(count, self.splatting.kernels, self.device)

    def upload(self, values: NDArray[Any]) -> Tensor:
        """A copy on the device."""
        return upload(values, self.device)

    def stored(self, drawn: Drawable, sh_degree: int | None = None) -> Stored:
        """Stored values on the device: an optimiser's in place, others travel."""
        if isinstance(drawn, CudaOptimiser):
            return Stored.of([drawn.values[name] for name in ATTRIBUTES], sh_degree)
        splats = drawn if isinstance(drawn, Splats) else drawn.splats
        return Stored.of([self.upload(getattr(splats, name)) for name in ATTRIBUTES], sh_degree)

    def committed(self, scene: Splats, rows: RowArray, renumbered: RowArray | None) -> Committed:
        """What a commit brings, which travels once for all views that ask in a row."""
        asked = (scene, rows, renumbered)
        if self._committed is None or any(a is not b for a, b in zip(asked, self._committed[0], strict=True)):
            kept = None
            if renumbered is not None:
                stays = np.flatnonzero(renumbered >= 0)
                kept = self.upload(stays), self.upload(renumbered[stays])
            commit = Committed(self.stored(take_splats(scene, rows)), self.upload(rows), kept)
            self._committed = asked, commit
        return self._committed[1]

    def _last(self, count: int) -> Drawn:
        if self._drawn is None or count != len(self._drawn.stored):
            raise ValueError("the scene must be that of the last forward")
        return self._drawn
