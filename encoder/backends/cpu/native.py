"""The training kernel's C interface: its structs, its functions, and where arrays lie for it (kernel/training.cpp)."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import (
    NativeCamera,
    NativePlanes,
    NativeScene,
)
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.system.kernels import check_memory, load_kernel

from ..protocol import ATTRIBUTES, SplatGradients

_TILE_PIXELS = 16
"""Side of the kernel's tiles (kernel/project.h)."""


class NativeCotangents(NativePlanes):
    """Gradients of a loss with respect to a rendering, as the kernel reads them."""


class NativeGradients(ctypes.Structure):
    """Gradients with respect to a scene, as the kernel writes them."""

    _fields_ = [
        (name, ctypes.c_void_p) for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view")
    ]


class NativeLoss(ctypes.Structure):
    """A picture and what it is compared with, as the kernel reads them (kernel/loss.h)."""

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


class NativeSums(ctypes.Structure):
    """The loss's sums, as the kernel writes them."""

    _fields_ = [("l1", ctypes.c_double), ("ssim", ctypes.c_double)]


class AdamStep(ctypes.Structure):
    """Adam's numbers at one step, as the kernels read them (kernel/adam.h)."""

    _fields_ = [(name, ctypes.c_float) for name in ("beta1", "beta2", "epsilon", "correction1", "correction2")]


def adam_step(step: int, beta1: float, beta2: float, epsilon: float) -> AdamStep:
    """Adam's numbers at ``step``, counted from 1."""
    # The kernels see betas rounded to float32; corrections from the same numbers keep the first step's size exact.
    beta1, beta2 = float(np.float32(beta1)), float(np.float32(beta2))
    return AdamStep(beta1, beta2, epsilon, 1 - beta1**step, 1 - beta2**step)


_STRUCTS = [
    NativeScene,
    NativeCamera,
    NativePlanes,
    NativeCotangents,
    NativeGradients,
    NativeLoss,
    NativeSums,
    AdamStep,
]
"""Of the kernel's interface, in the order of its ``decogs_sizes``."""


@lru_cache(maxsize=1)
def training_library() -> ctypes.CDLL:
    """The training kernel, compiled for this processor and loaded once."""
    library = load_kernel(Path(__file__).parent, "_training", _STRUCTS)
    pointer, handle = ctypes.POINTER, ctypes.c_void_p
    library.decogs_trainer_create.restype = handle
    library.decogs_trainer_create.argtypes = [ctypes.c_int]
    library.decogs_trainer_destroy.argtypes = [handle]
    library.decogs_forward.argtypes = [
        handle,
        pointer(NativeScene),
        pointer(NativeCamera),
        handle,
        pointer(NativePlanes),
    ]
    library.decogs_backward.restype = check_memory
    library.decogs_backward.argtypes = [
        handle,
        pointer(NativeScene),
        pointer(NativeCamera),
        pointer(NativeCotangents),
        pointer(NativeGradients),
    ]
    library.decogs_view_create.restype = handle
    library.decogs_view_create.argtypes = [pointer(NativeCamera), handle]
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
    library.decogs_loss.argtypes = [handle, pointer(NativeLoss), ctypes.c_void_p, pointer(NativeSums)]
    library.decogs_adam.restype = check_memory
    library.decogs_adam.argtypes = [
        handle,
        pointer(AdamStep),
        ctypes.c_int64,
        ctypes.c_int,
        *[ctypes.c_void_p] * 5,
    ]
    library.decogs_centres.argtypes = [handle, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p]
    return library


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


def native_gradients(out: SplatGradients, splats: Splats) -> NativeGradients:
    """The kernel's view of room for gradients; raises ValueError unless it is shaped like ``splats``."""
    for name in (*ATTRIBUTES, "view"):
        wanted = getattr(splats, name).shape if name in ATTRIBUTES else (len(splats),)
        if getattr(out, name).shape != wanted:
            raise ValueError(f"gradients `{name}` of {getattr(out, name).shape} for splats of {wanted}")
    return NativeGradients(*(float_address(getattr(out, name)) for name in (*ATTRIBUTES, "view")))


def check_tiles(tiles: NDArray[np.uint8] | None, width: int, height: int) -> None:
    """Raises ValueError where ``tiles`` are not one byte per tile of the picture."""
    if tiles is not None and (tiles.dtype != np.uint8 or tiles.size != tile_count(width, height)):
        raise ValueError(f"{tiles.dtype} tiles of shape {tiles.shape} for a picture of {height} x {width}")


def tile_count(width: int, height: int) -> int:
    """How many of the kernel's tiles a picture has."""
    return -(-width // _TILE_PIXELS) * -(-height // _TILE_PIXELS)
