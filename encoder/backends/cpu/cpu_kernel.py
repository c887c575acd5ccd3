"""The backend of the processor: the differentiable renderer, the fused loss and Adam, arrays in and arrays out."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import NativePlanes, check_drawn, native_camera, native_scene
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.system.kernels import checked_handle
from decogs.formats.system.threads import thread_count

from ..arguments import check_cotangents
from ..protocol import BLACK, Colour, Drawable, LossValue, SplatGradients
from .fixed_view import CpuFixedView
from .native import (
    NativeCotangents,
    NativeLoss,
    NativeSums,
    adam_step,
    address,
    check_tiles,
    float_address,
    native_gradients,
    training_library,
)
from .optimiser import CpuOptimiser, drawn_splats, room_for_gradients
from .view_gradients import CpuViewGradients


@dataclass(frozen=True)
class HostPicture:
    """A rendering in the host's memory."""

    rgb: FloatArray
    alpha: FloatArray
    depth: FloatArray | None


class CpuKernel:
    """``TrainingKernel`` with its thread pool and buffers; results do not depend on the number of threads."""

    _cotangent: FloatArray | None
    leaves_processor_idle = False

    def __init__(self, threads: int = 0, background: Colour = BLACK) -> None:
        self.background = background
        self._library = training_library()
        self.handle = checked_handle(self._library.decogs_trainer_create(thread_count(threads)))

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            self._library.decogs_trainer_destroy(self.handle)

    def forward(
        self,
        splats: Drawable,
        camera: Camera,
        background: Colour | None = None,
        *,
        sh_degree: int | None = None,
        depth: bool = False,
        tiles: NDArray[np.uint8] | None = None,
    ) -> HostPicture:
        check_tiles(tiles, camera.width, camera.height)
        size, background = (camera.height, camera.width), background or self.background
        picture = HostPicture(
            np.empty((3, *size), np.float32), np.empty(size, np.float32), np.empty(size, np.float32) if depth else None
        )
        planes = NativePlanes(
            address(picture.rgb), address(picture.alpha), address(picture.depth), (ctypes.c_float * 3)(*background)
        )
        self._splats: Splats | None = None  # a refused scene has no way back
        values = drawn_splats(splats)
        self._scene, self._camera = native_scene(values, sh_degree), native_camera(camera)
        self._shape, self._background = size, background
        self._picture, self._cotangent, self._tiles = picture, None, tiles
        status = self._library.decogs_forward(
            self.handle,
            ctypes.byref(self._scene),
            ctypes.byref(self._camera),
            address(tiles),
            ctypes.byref(planes),
        )
        check_drawn(status, camera.width, camera.height)
        self._splats = values  # the kernel reads these arrays again on the way back
        return picture

    def backward(
        self,
        splats: Drawable,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> SplatGradients:
        values = self._last(len(splats))
        v_rgb = self._cotangent if v_rgb is None else v_rgb
        if v_rgb is None:
            raise ValueError("backward needs a cotangent, or the loss of the last picture")
        check_cotangents(self._shape, v_rgb, v_alpha, v_depth)
        out = out or room_for_gradients(splats)
        cotangents = NativeCotangents(
            float_address(v_rgb),
            float_address(v_alpha),
            float_address(v_depth),
            (ctypes.c_float * 3)(*self._background),
        )
        self._library.decogs_backward(
            self.handle,
            ctypes.byref(self._scene),
            ctypes.byref(self._camera),
            ctypes.byref(cotangents),
            ctypes.byref(native_gradients(out, values)),
        )
        return out

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        self._last(count)
        centres, depths = np.empty((count, 2), np.float32), np.empty(count, np.float32)
        self._library.decogs_centres(self.handle, count, address(centres), address(depths))
        return centres, depths

    def picture_loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        if not hasattr(self, "_picture"):
            raise ValueError("picture_loss needs a forward before it")
        value, self._cotangent = self.loss(
            self._picture.rgb,
            target,
            l1_scale=l1_scale,
            ssim_scale=ssim_scale,
            l1_weight=l1_weight,
            focus=focus,
            tiles=self._tiles,
        )
        return value

    def bring(self, *arrays: FloatArray | None) -> None:
        pass  # They are there.

    def loss(
        self,
        image: FloatArray,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
        tiles: NDArray[np.uint8] | None = None,
        gradient: FloatArray | None = None,
    ) -> tuple[LossValue, FloatArray]:
        """``picture_loss`` of any ``image``, and its gradient.

        Shapes: image, target and gradient (3, H, W); l1_weight and focus (H, W). With ``tiles``, one number per 16x16
        tile in rows, only pixels of tiles that are not 0 are summed and given a gradient; the others' gradients are
        left as they were.
        """
        if image.shape != target.shape:
            raise ValueError(f"picture {image.shape} against target {target.shape}")
        gradient = np.empty_like(image) if gradient is None else gradient
        _, height, width = image.shape
        if image.shape[0] != 3 or gradient.shape != image.shape or gradient.dtype != np.float32:
            raise ValueError(f"picture {image.shape} with a gradient of {gradient.dtype} {gradient.shape}")
        for plane in (l1_weight, focus):
            if plane is not None and plane.shape != (height, width):
                raise ValueError(f"weights of shape {plane.shape} for a picture of {height} x {width}")
        check_tiles(tiles, width, height)
        planes = (float_address(a) for a in (image, target, l1_weight, focus))
        given = NativeLoss(*planes, address(tiles), l1_scale, ssim_scale, width, height)
        sums = NativeSums()
        self._library.decogs_loss(self.handle, ctypes.byref(given), address(gradient), ctypes.byref(sums))
        return LossValue(l1_scale, ssim_scale, lambda: (sums.l1, sums.ssim)), gradient

    def adam(
        self,
        value: FloatArray,
        gradient: FloatArray,
        first: FloatArray,
        second: FloatArray,
        *,
        rate: float | FloatArray,
        step: int,
        beta1: float = 0.9,
        beta2: float = 0.999,
        epsilon: float = 1e-15,
    ) -> None:
        """One Adam step (Kingma 2015) of ``value`` in place; ``step`` counts from 1.

        ``rate`` is one number, or one per column of ``value`` seen as (N, columns).
        """
        columns = math.prod(value.shape[1:])
        rates = np.empty(columns, np.float32)
        rates[:] = rate
        if any(a.shape != value.shape for a in (gradient, first, second)):
            raise ValueError(f"gradient and moments must have the shape of the value, {value.shape}")
        setting = adam_step(step, beta1, beta2, epsilon)
        self._library.decogs_adam(
            self.handle,
            ctypes.byref(setting),
            len(value),
            columns,
            *(float_address(a) for a in (rates, value, gradient, first, second)),
        )

    def fixed_view(self, camera: Camera, recorded: NDArray[np.bool_] | None = None) -> CpuFixedView:
        return CpuFixedView(self, camera, recorded)

    def optimiser(self, splats: Splats, *, beta1: float = 0.9, beta2: float = 0.999) -> CpuOptimiser:
        return CpuOptimiser(splats, self, beta1=beta1, beta2=beta2)

    def view_gradients(self, count: int) -> CpuViewGradients:
        return CpuViewGradients(count)

    def _last(self, count: int) -> Splats:
        last: Splats | None = getattr(self, "_splats", None)
        if last is None or len(last) != count:
            raise ValueError("the scene must be that of the last forward")
        return last
