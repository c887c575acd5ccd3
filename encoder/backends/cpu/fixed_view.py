"""A fixed camera that watches a scene of which few Gaussians change: the exact sparse path of training.

What does not change is neither projected, nor sorted, nor drawn again; pictures and gradients have the bits of a whole
rendering. Design and rejected alternatives: kernel/fixed_view.h.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import (
    NativePlanes,
    RowArray,
    check_drawn,
    check_renumbered,
    checked_rows,
    native_camera,
    native_scene,
)
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.system.kernels import checked_handle

from ..arguments import check_cotangents, check_marks, rows_of
from ..protocol import Drawable, LossValue, SplatGradients
from .native import NativeCotangents, address, float_address, native_gradients, tile_count, training_library
from .optimiser import drawn_splats, room_for_gradients

if TYPE_CHECKING:
    from .cpu_kernel import CpuKernel


class CpuFixedView:
    """``FixedView`` on the native kernel."""

    def __init__(self, kernel: CpuKernel, camera: Camera, recorded: NDArray[np.bool_] | None = None) -> None:
        check_marks(recorded, camera)
        self._library, self._kernel, self.camera = training_library(), kernel, camera
        self._native, self._background = native_camera(camera), (ctypes.c_float * 3)(*kernel.background)
        size = (camera.height, camera.width)
        self._rgb: FloatArray = np.zeros((3, *size), np.float32)
        self._alpha: FloatArray = np.zeros(size, np.float32)
        self._depth: FloatArray = np.zeros(size, np.float32)
        self._met: NDArray[np.uint8] = np.zeros(tile_count(camera.width, camera.height), np.uint8)
        self._detached: NDArray[np.bool_] | None = np.zeros(0, np.bool_)
        self._drawn: tuple[Drawable, Splats, RowArray] | None = None
        self._cotangent: FloatArray | None = None
        self._evaluated = False
        self._recorded = recorded  # the kernel reads it at every redraw
        self._handle = checked_handle(self._library.decogs_view_create(ctypes.byref(self._native), address(recorded)))

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self._library.decogs_view_destroy(self._handle)

    @property
    def rgb(self) -> FloatArray:
        return self._rgb

    @property
    def alpha(self) -> FloatArray:
        return self._alpha

    @property
    def depth(self) -> FloatArray:
        return self._depth

    @property
    def met(self) -> NDArray[np.uint8]:
        return self._met

    def set_scene(self, scene: Splats) -> None:
        placed = native_scene(scene)
        self._detached = self._drawn = None
        self._check(self._library.decogs_view_set_scene(self._kernel.handle, self._handle, ctypes.byref(placed)))
        self._detached = np.zeros(len(scene), np.bool_)

    def refresh(self) -> None:
        self._loaded()
        self._redraw(None, None)

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        check_marks(marks, self.camera)
        weights = np.empty((2, len(self._loaded())), np.float32)
        self._redraw(marks, weights)
        return weights

    def _redraw(self, marks: NDArray[np.bool_] | None, weights: FloatArray | None) -> None:
        planes, count = self._planes(depth=True), 0 if weights is None else weights.shape[1]
        self._library.decogs_view_redraw(
            self._kernel.handle, self._handle, address(marks), ctypes.byref(planes), address(weights), count
        )

    def detach(self, rows: RowArray) -> None:
        detached = self._loaded()
        rows = checked_rows(rows, len(detached))
        self._library.decogs_view_detach(self._handle, address(rows), len(rows))
        detached[rows] = True

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        rows, values = rows_of(moving, rows, len(self._loaded())), drawn_splats(moving)
        planes = self._planes(depth=depth)
        self._drawn, self._evaluated = None, False
        self._scene = native_scene(values)
        status = self._library.decogs_view_draw(
            self._kernel.handle,
            self._handle,
            ctypes.byref(self._scene),
            address(rows),
            ctypes.byref(planes),
            address(self._met),
        )
        self._check(status)
        self._drawn = moving, values, rows  # the arrays are read again on the way back

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        value, self._cotangent = self._kernel.loss(
            self._rgb,
            target,
            l1_scale=l1_scale,
            ssim_scale=ssim_scale,
            l1_weight=l1_weight,
            focus=focus,
            tiles=self._met,
            gradient=self._cotangent,
        )
        self._evaluated = True
        return value

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> SplatGradients:
        if v_rgb is None and self._evaluated:
            v_rgb = self._cotangent
        if self._drawn is None or v_rgb is None:
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        check_cotangents((self.camera.height, self.camera.width), v_rgb)
        moving, values, _ = self._drawn
        out = out or room_for_gradients(moving)
        cotangents = NativeCotangents(float_address(v_rgb), None, None, self._background)
        self._library.decogs_view_backward(
            self._kernel.handle,
            self._handle,
            ctypes.byref(self._scene),
            ctypes.byref(cotangents),
            ctypes.byref(native_gradients(out, values)),
        )
        return out

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        detached, rows, committed = self._loaded(), checked_rows(rows, len(scene)), native_scene(scene)
        renumbered = check_renumbered(renumbered, detached, len(scene))
        self._detached = self._drawn = None
        status = self._library.decogs_view_commit(
            self._kernel.handle,
            self._handle,
            ctypes.byref(committed),
            address(rows),
            len(rows),
            address(renumbered),
            len(detached),
        )
        self._check(status)
        self._detached = np.zeros(len(scene), np.bool_)

    def squared_error(self, picture: FloatArray, counted: FloatArray | None = None) -> float:
        square = (np.clip(self._rgb, 0, 1) - picture) ** 2
        if counted is not None:
            square = square * counted
        return float(square.sum(dtype=np.float64))

    def centres(self) -> FloatArray:
        centres = np.empty((len(self._loaded()), 2), np.float32)
        self._library.decogs_view_centres(self._handle, len(centres), address(centres))
        return centres

    def _loaded(self) -> NDArray[np.bool_]:
        """Which Gaussians of the scene are detached."""
        if self._detached is None:
            raise ValueError("the last scene was refused; place one first")
        return self._detached

    def _check(self, status: int) -> None:
        check_drawn(status, self.camera.width, self.camera.height)

    def _planes(self, *, depth: bool) -> NativePlanes:
        more = (address(self._alpha), address(self._depth)) if depth else (None, None)
        return NativePlanes(address(self._rgb), *more, self._background)
