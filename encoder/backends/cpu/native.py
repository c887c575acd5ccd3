"""The differentiable renderer, the fused loss and Adam: the training kernel's arrays-in, arrays-out interface."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import (
    NativeCamera,
    NativePlanes,
    NativeScene,
    check_drawn,
    native_camera,
    native_scene,
)
from decogs.formats.cameras import Camera
from decogs.formats.kernels import check_memory, checked_handle, load_kernel
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.threads import thread_count

_TILE = 16
"""Side of the kernel's tiles (kernel/project.h)."""


class NativeCotangents(NativePlanes):
    """Gradients of a loss with respect to a rendering, as the kernel reads them."""


class NativeGradients(ctypes.Structure):
    """Gradients with respect to a scene, as the kernel writes them."""

    _fields_ = [
        (name, ctypes.c_void_p) for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view")
    ]


class _LossInput(ctypes.Structure):
    _fields_ = [
        ("image", ctypes.c_void_p),
        ("target", ctypes.c_void_p),
        ("l1_weight", ctypes.c_void_p),
        ("focus", ctypes.c_void_p),
        ("tiles", ctypes.c_void_p),
        ("l1_scale", ctypes.c_float),
        ("ssim_scale", ctypes.c_float),
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
    ]


class _LossSums(ctypes.Structure):
    _fields_ = [("l1", ctypes.c_double), ("ssim", ctypes.c_double)]


class AdamStep(ctypes.Structure):
    """Adam's numbers at one step, as the kernels read them (kernel/adam.h)."""

    _fields_ = [(name, ctypes.c_float) for name in ("beta1", "beta2", "epsilon", "correction1", "correction2")]


def adam_step(step: int, beta1: float, beta2: float, epsilon: float) -> AdamStep:
    """Adam's numbers at ``step``, counted from 1."""
    # The kernels see betas rounded to float32; corrections from the same numbers keep the first step's size exact.
    beta1, beta2 = float(np.float32(beta1)), float(np.float32(beta2))
    return AdamStep(beta1, beta2, epsilon, 1 - beta1**step, 1 - beta2**step)


@lru_cache(maxsize=1)
def training_library() -> ctypes.CDLL:
    """The training kernel, compiled for this processor and loaded once."""
    library = load_kernel(Path(__file__).parent, "_training")
    pointer, handle = ctypes.POINTER, ctypes.c_void_p
    library.decogs_trainer_create.restype = handle
    library.decogs_trainer_create.argtypes = [ctypes.c_int]
    library.decogs_trainer_destroy.argtypes = [handle]
    library.decogs_forward.argtypes = [handle, pointer(NativeScene), pointer(NativeCamera), pointer(NativePlanes)]
    library.decogs_backward.restype = check_memory
    library.decogs_backward.argtypes = [
        handle,
        pointer(NativeScene),
        pointer(NativeCamera),
        pointer(NativeCotangents),
        pointer(NativeGradients),
    ]
    library.decogs_view_create.restype = handle
    library.decogs_view_create.argtypes = [pointer(NativeCamera)]
    library.decogs_view_destroy.argtypes = [handle]
    library.decogs_view_set_scene.argtypes = [handle, handle, pointer(NativeScene)]
    library.decogs_view_detach.restype = check_memory
    library.decogs_view_detach.argtypes = [handle, handle, ctypes.c_int64]
    library.decogs_view_draw.argtypes = [handle, handle, pointer(NativeScene), handle, pointer(NativePlanes), handle]
    library.decogs_view_backward.restype = check_memory
    library.decogs_view_backward.argtypes = [
        handle,
        handle,
        pointer(NativeScene),
        pointer(NativeCotangents),
        pointer(NativeGradients),
    ]
    library.decogs_view_commit.argtypes = [
        handle,
        handle,
        pointer(NativeScene),
        handle,
        ctypes.c_int64,
        handle,
        ctypes.c_int64,
    ]
    library.decogs_view_redraw.restype = check_memory
    library.decogs_view_redraw.argtypes = [handle, handle, handle, pointer(NativePlanes), handle, ctypes.c_int64]
    library.decogs_view_centres.argtypes = [handle, ctypes.c_int64, handle]
    library.decogs_loss.restype = check_memory
    library.decogs_loss.argtypes = [handle, pointer(_LossInput), ctypes.c_void_p, pointer(_LossSums)]
    library.decogs_adam.restype = check_memory
    library.decogs_adam.argtypes = [
        handle,
        pointer(AdamStep),
        ctypes.c_int64,
        ctypes.c_void_p,
        ctypes.c_int,
        *[ctypes.c_void_p] * 5,
    ]
    library.decogs_centres.argtypes = [handle, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p]
    return library


class RenderedPicture(Protocol):
    """A rendering, planar: rgb (3, H, W), alpha (H, W), summed depth (H, W) or None."""

    @property
    def rgb(self) -> FloatArray:
        """Colours (3, H, W) float32, display-referred."""
        ...

    @property
    def alpha(self) -> FloatArray:
        """Opacity (H, W) float32, 0 to 1."""
        ...

    @property
    def depth(self) -> FloatArray | None:
        """Depth (H, W) float32 in world units, summed with the rendering weights; None where it was not rendered."""
        ...


@dataclass(frozen=True)
class HostPicture:
    """A rendering in the host's memory."""

    rgb: FloatArray
    alpha: FloatArray
    depth: FloatArray | None


@dataclass(frozen=True)
class SplatGradients:
    """Gradients of the stored values, shaped like them; ``view`` (N,): length of the projected centre's, in pixels."""

    means: FloatArray
    log_scales: FloatArray
    quaternions: FloatArray
    opacity_logits: FloatArray
    sh: FloatArray
    view: FloatArray

    def native(self, splats: Splats) -> NativeGradients:
        """The kernel's view of these arrays; raises ValueError unless they are shaped like ``splats``."""
        if self.view.shape != (len(splats),) or self.sh.shape != splats.sh.shape:
            raise ValueError(f"gradients of {self.sh.shape} for splats of {splats.sh.shape}")
        arrays = (self.means, self.log_scales, self.quaternions, self.opacity_logits, self.sh, self.view)
        return NativeGradients(*(float_address(a) for a in arrays))


def gradients_like(splats: Splats) -> SplatGradients:
    """Room for the gradients of ``splats``, to be reused from step to step."""
    return SplatGradients(
        np.empty_like(splats.means),
        np.empty_like(splats.log_scales),
        np.empty_like(splats.quaternions),
        np.empty_like(splats.opacity_logits),
        np.empty_like(splats.sh),
        np.empty(len(splats), np.float32),
    )


@dataclass(frozen=True)
class LossValue:
    """What a picture costs where it was looked at: the loss itself, its weighted L1 and SSIM sums."""

    total: float
    l1: float
    ssim: float


def address(array: NDArray[np.generic] | None) -> int | None:
    """Where the array lies for the kernel, None for none; raises ValueError unless it is C-contiguous."""
    if array is None:
        return None
    if not array.flags.c_contiguous:
        raise ValueError("the kernel reads C-contiguous arrays only")
    return array.ctypes.data


def float_address(array: FloatArray | None) -> int | None:
    """Where a float32 array lies for the kernel, None for none; raises ValueError for another type or layout."""
    if array is not None and array.dtype != np.float32:
        raise ValueError("the kernel reads float32 arrays only")
    return address(array)


def tile_count(width: int, height: int) -> int:
    """How many of the kernel's tiles a picture has."""
    return -(-width // _TILE) * -(-height // _TILE)


class TrainingKernel:
    """One differentiable renderer with its thread pool and buffers; results do not depend on the number of threads.

    ``forward`` must come before ``backward`` and ``centres``, with the same scene and camera.
    """

    _cotangent: FloatArray | None

    def __init__(self, threads: int = 0) -> None:
        self._library = training_library()
        self.handle = checked_handle(self._library.decogs_trainer_create(thread_count(threads)))

    def __del__(self) -> None:
        if hasattr(self, "handle"):
            self._library.decogs_trainer_destroy(self.handle)

    def forward(
        self,
        splats: Splats,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        sh_degree: int | None = None,
        depth: bool = False,
    ) -> RenderedPicture:
        """Renders and remembers what the way back needs; UsageError when the scene covers the picture too often."""
        size = (camera.height, camera.width)
        picture = HostPicture(
            np.empty((3, *size), np.float32), np.empty(size, np.float32), np.empty(size, np.float32) if depth else None
        )
        planes = NativePlanes(
            address(picture.rgb), address(picture.alpha), address(picture.depth), (ctypes.c_float * 3)(*background)
        )
        self._splats: Splats | None = None  # a refused scene has no way back
        self._scene, self._camera = native_scene(splats, sh_degree), native_camera(camera)
        self._shape, self._background = size, background
        self._picture, self._cotangent = picture, None
        status = self._library.decogs_forward(
            self.handle, ctypes.byref(self._scene), ctypes.byref(self._camera), ctypes.byref(planes)
        )
        check_drawn(status, camera.width, camera.height)
        self._splats = splats  # the kernel reads these arrays again on the way back
        return picture

    def backward(
        self,
        splats: Splats,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> SplatGradients:
        """Gradients of every Gaussian for the cotangents of the last picture; without ``v_rgb``, for its loss."""
        self._check_last(len(splats))
        v_rgb = self._cotangent if v_rgb is None else v_rgb
        if v_rgb is None:
            raise ValueError("backward needs a cotangent, or the loss of the last picture")
        out = out or gradients_like(splats)
        for cotangent, shape in ((v_rgb, (3, *self._shape)), (v_alpha, self._shape), (v_depth, self._shape)):
            if cotangent is not None and cotangent.shape != shape:
                raise ValueError(f"cotangent of shape {cotangent.shape} for a picture of {self._shape}")
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
            ctypes.byref(out.native(splats)),
        )
        return out

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Projected centres (N, 2) in pixels and depths (N,) of the last picture; NaN where nothing was drawn."""
        self._check_last(count)
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
        """``loss`` of the last picture of ``forward``; its gradient waits for ``backward``.

        The arrays must not change as long as they live: a device keeps its copy of them.
        """
        if not hasattr(self, "_picture"):
            raise ValueError("picture_loss needs a forward before it")
        value, self._cotangent = self.loss(
            self._picture.rgb, target, l1_scale=l1_scale, ssim_scale=ssim_scale, l1_weight=l1_weight, focus=focus
        )
        return value

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
        """``l1_scale * sum(l1_weight |a-b|) + ssim_scale * sum(focus (1 - SSIM(focus a, focus b)))`` and its gradient.

        Shapes: image, target and gradient (3, H, W); l1_weight and focus (H, W). With ``tiles``, one number per 16x16
        tile in rows, only pixels of tiles that are not 0 are summed and given a gradient; the others' gradients are
        left as they were. Source: Wang 2004, Kerbl 2023 eq. 7.
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
        if tiles is not None and (tiles.dtype != np.uint8 or tiles.size != tile_count(width, height)):
            raise ValueError(f"{tiles.dtype} tiles of shape {tiles.shape} for a picture of {height} x {width}")
        planes = (float_address(a) for a in (image, target, l1_weight, focus))
        given = _LossInput(*planes, address(tiles), l1_scale, ssim_scale, width, height)
        sums = _LossSums()
        self._library.decogs_loss(self.handle, ctypes.byref(given), address(gradient), ctypes.byref(sums))
        total = l1_scale * sums.l1 + ssim_scale * sums.ssim
        return LossValue(total, sums.l1, sums.ssim), gradient

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
        rows: NDArray[np.int64] | None = None,
    ) -> None:
        """One Adam step (Kingma 2015) in place on ``rows`` of ``value``; ``step`` counts from 1.

        ``rate`` is one number, or one per column of ``value`` seen as (N, columns).
        """
        count, columns = len(value), math.prod(value.shape[1:])
        rates = np.empty(columns, np.float32)
        rates[:] = rate
        if any(a.shape != value.shape for a in (gradient, first, second)):
            raise ValueError(f"gradient and moments must have the shape of the value, {value.shape}")
        if rows is not None:
            if rows.dtype != np.int64:
                raise ValueError(f"rows must be int64, not {rows.dtype}")
            if rows.min(initial=0) < 0 or rows.max(initial=-1) >= count:
                raise ValueError(f"rows must lie below {count}")
        setting = adam_step(step, beta1, beta2, epsilon)
        self._library.decogs_adam(
            self.handle,
            ctypes.byref(setting),
            count if rows is None else len(rows),
            address(rows),
            columns,
            *(float_address(a) for a in (rates, value, gradient, first, second)),
        )

    def _check_last(self, count: int) -> None:
        last: Splats | None = getattr(self, "_splats", None)
        if last is None or len(last) != count:
            raise ValueError("the scene must be that of the last forward")
