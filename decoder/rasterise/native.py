"""The fast renderer: loads the C++ kernel built for this machine's instruction set and hands it plain arrays."""

from __future__ import annotations

import ctypes
import os
import weakref
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre, turned
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.system.kernels import check_memory, checked_handle, load_kernel
from decogs.formats.system.threads import thread_count

RowArray = NDArray[np.int64]

MAX_PAIRS = 1 << 27
"""Pairs of a 16x16 tile and a Gaussian in one picture that the kernel lists at most, whatever is allowed."""

_COVERED, _NO_MEMORY = 1, 2
"""What the kernels say of their work beside 0, all is well (kernel/pool.h)."""

FAR_OUT = 256.0
"""Cameras further from the world's origin than this, in world units, see positions from where they are: rotating about
an origin 1e6 units away would cost pixels. Nearer ones lose less than 1e-4 of a unit."""


class NativeCamera(ctypes.Structure):
    """A pinhole camera as the kernel reads it (kernel/project.h)."""

    _fields_ = [
        ("rotation", ctypes.c_float * 9),
        ("translation", ctypes.c_float * 3),
        ("centre", ctypes.c_float * 3),
        ("origin", ctypes.c_float * 3),
        ("fx", ctypes.c_float),
        ("fy", ctypes.c_float),
        ("cx", ctypes.c_float),
        ("cy", ctypes.c_float),
        ("near", ctypes.c_float),
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
    ]


class NativeScene(ctypes.Structure):
    """Stored values of N Gaussians as the kernel reads them (kernel/project.h)."""

    _fields_ = [
        ("count", ctypes.c_int64),
        ("sh_coefficients", ctypes.c_int32),
        ("sh_degree", ctypes.c_int32),
        ("means", ctypes.c_void_p),
        ("log_scales", ctypes.c_void_p),
        ("quaternions", ctypes.c_void_p),
        ("opacity_logits", ctypes.c_void_p),
        ("sh", ctypes.c_void_p),
    ]


class NativePlanes(ctypes.Structure):
    """Where the kernel writes planar pictures (kernel/composite.h)."""

    _fields_ = [
        ("rgb", ctypes.c_void_p),
        ("alpha", ctypes.c_void_p),
        ("depth", ctypes.c_void_p),
        ("background", ctypes.c_float * 3),
    ]


class NativePicture(ctypes.Structure):
    """Where the kernel writes a picture as it is handed out (kernel/incremental_view.h)."""

    _fields_ = [("image", ctypes.c_void_p), ("depth", ctypes.c_void_p)]


def native_camera(camera: Camera) -> NativeCamera:
    """The kernel's form of a pinhole camera; its lens distortion, if any, is not its concern."""
    pose, centre, origin = np.asarray(camera.world_to_camera, np.float64), camera_centre(camera), np.zeros(3)
    if np.linalg.norm(centre) > FAR_OUT:
        # Positions near this one lose no digits when it is taken from them: their float32 difference is exact.
        origin = centre.astype(np.float32).astype(np.float64)
    return NativeCamera(
        (ctypes.c_float * 9)(*pose[:3, :3].ravel()),
        (ctypes.c_float * 3)(*(pose[:3, 3] + turned(pose[:3, :3], origin))),
        (ctypes.c_float * 3)(*(centre - origin)),
        (ctypes.c_float * 3)(*origin),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        camera.near,
        camera.width,
        camera.height,
    )


def native_scene(splats: Splats, sh_degree: int | None = None) -> NativeScene:
    """The kernel's view of stored values; the arrays must outlive it."""
    n, coefficients = len(splats), splats.sh.shape[1]
    for array, shape in (
        (splats.means, (n, 3)),
        (splats.log_scales, (n, 3)),
        (splats.quaternions, (n, 4)),
        (splats.opacity_logits, (n,)),
        (splats.sh, (n, coefficients, 3)),
    ):
        if array.dtype != np.float32 or not array.flags.c_contiguous or array.shape != shape:
            raise ValueError(f"splats must be C-contiguous float32: {array.dtype} {array.shape}, expected {shape}")
    return NativeScene(
        n,
        coefficients,
        splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree),
        splats.means.ctypes.data,
        splats.log_scales.ctypes.data,
        splats.quaternions.ctypes.data,
        splats.opacity_logits.ctypes.data,
        splats.sh.ctypes.data,
    )


def checked_rows(rows: RowArray, population: int | None) -> RowArray:
    """The rows for the kernel; ValueError unless they ascend and lie in a scene of ``population`` Gaussians."""
    if rows.dtype != np.int64 or rows.ndim != 1:
        raise ValueError(f"rows must be int64, not {rows.dtype} {rows.shape}")
    outside = len(rows) > 0 and (rows[0] < 0 or (population is not None and rows[-1] >= population))
    if outside or (np.diff(rows) <= 0).any():
        raise ValueError("rows must ascend and lie in the scene")
    return np.ascontiguousarray(rows)


def check_renumbered(renumbered: RowArray | None, detached: NDArray[np.bool_], population: int) -> RowArray | None:
    """Every former row's new one for the kernel, -1 for detached ones that are gone; ValueError for anything else.

    ``detached`` (N,): which of the former rows are. Rows keep their order and move down only: the kernel relies on it.
    """
    if renumbered is None:
        if population < len(detached):
            raise ValueError(f"{len(detached)} Gaussians in a scene of {population} need new numbers")
        return None
    if renumbered.shape != detached.shape or renumbered.dtype != np.int64:
        raise ValueError(f"{renumbered.dtype} {renumbered.shape} new numbers for {len(detached)} Gaussians, not int64")
    stays = renumbered >= 0
    kept = renumbered[stays]
    if (renumbered < -1).any() or not detached[~stays].all():
        raise ValueError("only detached Gaussians can go, as -1")
    if len(kept) and ((np.diff(kept) <= 0).any() or kept[-1] >= population or (kept > np.flatnonzero(stays)).any()):
        raise ValueError(f"new numbers must ascend, lie below {population} and be at most the former ones")
    return np.ascontiguousarray(renumbered)


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    library = load_kernel(Path(__file__).parent, "_forward", [NativeScene, NativeCamera, NativePlanes, NativePicture])
    library.decogs_renderer_create.restype = ctypes.c_void_p
    library.decogs_renderer_create.argtypes = [ctypes.c_int]
    library.decogs_renderer_destroy.argtypes = [ctypes.c_void_p]
    pointers = [ctypes.POINTER(t) for t in (NativeScene, NativeCamera, NativePlanes)]
    library.decogs_render.restype = ctypes.c_int
    library.decogs_render.argtypes = [ctypes.c_void_p, *pointers, ctypes.c_uint64]
    handle, scene, camera, planes = ctypes.c_void_p, *pointers
    library.decogs_incremental_create.restype = handle
    library.decogs_incremental_create.argtypes = [camera]
    library.decogs_incremental_destroy.argtypes = [handle]
    library.decogs_incremental_allow.restype = None
    library.decogs_incremental_allow.argtypes = [handle, ctypes.c_uint64]
    library.decogs_incremental_set_scene.restype = ctypes.c_int
    library.decogs_incremental_set_scene.argtypes = [handle, handle, scene]
    library.decogs_incremental_change.restype = ctypes.c_int
    library.decogs_incremental_change.argtypes = [
        handle,
        handle,
        handle,
        ctypes.c_int64,
        scene,
        handle,
        ctypes.c_int64,
        handle,
        ctypes.c_int64,
    ]
    library.decogs_incremental_redraw.restype = check_memory
    library.decogs_incremental_redraw.argtypes = [
        handle,
        handle,
        planes,
        ctypes.POINTER(NativePicture),
        ctypes.POINTER(ctypes.c_int64),
    ]
    return library


class Renderer:
    """Owns a thread pool and the kernel's buffers; one picture at a time, whoever asks for it.

    In a forked child it works on: the pool starts threads of its own there.
    """

    def __init__(self, threads: int) -> None:
        self.kernel, self._threads = _library(), threads
        self._lock = Lock()
        self._handle = checked_handle(self.kernel.decogs_renderer_create(threads))
        _renderers.add(self)

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self.kernel.decogs_renderer_destroy(self._handle)

    def after_fork(self) -> None:
        """In the child: a picture that another thread of the parent was at is nobody's now, and its buffers with it."""
        if self._lock.locked():
            self._lock = Lock()
            self._handle = checked_handle(self.kernel.decogs_renderer_create(self._threads))

    def run(self, function: Callable[..., Any], *arguments: object) -> Any:
        """Calls a function of ``kernel`` that works on this renderer."""
        with self._lock:  # ctypes lets other Python threads in while the kernel runs
            return function(self._handle, *arguments)


_renderers: weakref.WeakSet[Renderer] = weakref.WeakSet()


def _after_fork() -> None:
    for each in list(_renderers):
        each.after_fork()


if hasattr(os, "register_at_fork"):  # Windows has no fork.
    os.register_at_fork(after_in_child=_after_fork)


@lru_cache(maxsize=2)
def _renderer(threads: int) -> Renderer:
    return Renderer(threads)


def renderer(threads: int) -> Renderer:
    """The renderer that all who want this number of threads share."""
    return _renderer(thread_count(threads))


def check_drawn(status: int, width: int, height: int, max_pairs: int = MAX_PAIRS) -> None:
    """Raises UsageError when the kernel refused a scene, MemoryError when it found no memory for the picture."""
    if status == _COVERED:
        more = " or more memory (`max_memory`)" if max_pairs < MAX_PAIRS else ""
        raise UsageError(
            f"a picture of {width}x{height} is covered too many times by the scene's Gaussians; "
            f"choose a smaller scale{more}"
        )
    check_memory(status)


def render_planes(
    splats: Splats,
    camera: Camera,
    background: tuple[float, float, float],
    threads: int,
    max_pairs: int = MAX_PAIRS,
) -> tuple[FloatArray, FloatArray, NDArray[np.float32]]:
    """Colour (3, H, W), alpha (H, W) and alpha-weighted summed depth (H, W) of the scene through a pinhole camera.

    UsageError above ``max_pairs`` of a tile and a Gaussian, which bounds the memory taken.
    """
    size = (camera.height, camera.width)
    rgb, alpha, depth = np.empty((3, *size), np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    planes = NativePlanes(rgb.ctypes.data, alpha.ctypes.data, depth.ctypes.data, (ctypes.c_float * 3)(*background))
    shared, scene = renderer(threads), native_scene(splats)
    status = shared.run(
        shared.kernel.decogs_render,
        ctypes.byref(scene),
        ctypes.byref(native_camera(camera)),
        ctypes.byref(planes),
        max_pairs,
    )
    check_drawn(status, camera.width, camera.height, max_pairs)
    return rgb, alpha, depth
