"""A fixed camera that watches a scene of which few Gaussians change: the exact sparse path of training.

What does not change is neither projected, nor sorted, nor drawn again; pictures and gradients have the bits of a whole
rendering. Design and rejected alternatives: kernel/fixed_view.h.
"""

from __future__ import annotations

import ctypes

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
from decogs.formats.kernels import checked_handle
from decogs.formats.splats import FloatArray, Splats

from .native import (
    LossValue,
    NativeCotangents,
    SplatGradients,
    TrainingKernel,
    address,
    float_address,
    gradients_like,
    tile_count,
    training_library,
)

_MAX_NEW = 1 << 22
"""How far behind the scene's last Gaussian new ones are numbered at most; the kernel holds a place for each number."""


class FixedView:
    """The picture of a pinhole ``camera``, kept up to date while Gaussians change a few at a time.

    The order of calls: ``set_scene``; then for every frame ``redraw`` (as often as wanted), ``detach`` the Gaussians
    that are about to change, ``draw`` and ``backward`` as often as wanted, ``commit``.

    ``rgb`` (3, H, W), ``alpha`` and ``depth`` (H, W; the depth summed by weight) are the picture as last drawn or
    redrawn; ``alpha`` and ``depth`` are those of the last redraw or of the last draw with ``depth``.

    After a scene that was refused (UsageError, MemoryError) the next call must be ``set_scene``.
    """

    def __init__(self, kernel: TrainingKernel, camera: Camera) -> None:
        self._library, self._kernel, self.camera = training_library(), kernel, camera
        self._native = native_camera(camera)
        size = (camera.height, camera.width)
        self._rgb: FloatArray = np.zeros((3, *size), np.float32)
        self._alpha: FloatArray = np.zeros(size, np.float32)
        self._depth: FloatArray = np.zeros(size, np.float32)
        self._met: NDArray[np.uint8] = np.zeros(tile_count(camera.width, camera.height), np.uint8)
        self._detached: NDArray[np.bool_] | None = np.zeros(0, np.bool_)
        self._drawn: tuple[Splats, RowArray] | None = None
        self._cotangent: FloatArray | None = None
        self._evaluated = False
        self._handle = checked_handle(self._library.decogs_view_create(ctypes.byref(self._native)))

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self._library.decogs_view_destroy(self._handle)

    @property
    def rgb(self) -> FloatArray:
        """The picture (3, H, W) float32, display-referred; the next ``draw`` writes over it."""
        return self._rgb

    @property
    def alpha(self) -> FloatArray:
        """Opacity (H, W) float32 of the picture, 0 to 1."""
        return self._alpha

    @property
    def depth(self) -> FloatArray:
        """Depth (H, W) float32 in world units, summed with the rendering weights."""
        return self._depth

    @property
    def met(self) -> NDArray[np.uint8]:
        """One per 16x16 tile: whether a Gaussian of the last ``draw`` meets it. Nothing else can change its pixels."""
        return self._met

    def set_scene(self, scene: Splats) -> None:
        """Starts with a whole scene (N Gaussians), all of it static; the picture is there after ``redraw``."""
        placed = native_scene(scene)
        self._detached = self._drawn = None
        self._check(self._library.decogs_view_set_scene(self._kernel.handle, self._handle, ctypes.byref(placed)))
        self._detached = np.zeros(len(scene), np.bool_)

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        """Brings the picture up to date with the static scene; every Gaussian's rendering weight, (2, N).

        The weight is the sum of alpha times transmittance: in row 0 over all pixels, in row 1 over ``marks`` (H, W).
        """
        self._check_marks(marks)
        weights = np.empty((2, len(self._loaded())), np.float32)
        planes = self._planes(depth=True)
        self._library.decogs_view_redraw(
            self._kernel.handle,
            self._handle,
            address(marks),
            ctypes.byref(planes),
            address(weights),
            weights.shape[1],
        )
        return weights

    def detach(self, rows: RowArray) -> None:
        """Takes the Gaussians ``rows`` out of the static scene: they are what changes until ``commit``."""
        detached = self._loaded()
        rows = checked_rows(rows, len(detached))
        self._library.decogs_view_detach(self._handle, address(rows), len(rows))
        detached[rows] = True

    def draw(self, moving: Splats, rows: RowArray, *, depth: bool = False) -> None:
        """Brings the picture up to date with ``moving`` (M Gaussians) in it, which are the scene's ``rows``, ascending.

        Rows are detached ones, or new ones, numbered from N on. Detached ones that are left out do not show.
        """
        rows = self._checked_of(moving, rows)
        planes = self._planes(depth=depth)
        self._drawn, self._evaluated = None, False
        self._scene = native_scene(moving)
        status = self._library.decogs_view_draw(
            self._kernel.handle,
            self._handle,
            ctypes.byref(self._scene),
            address(rows),
            ctypes.byref(planes),
            address(self._met),
        )
        self._check(status)
        self._drawn = moving, rows  # the arrays are read again on the way back

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        """``TrainingKernel.loss`` of the last ``draw`` in the tiles of ``met``; its gradient waits for ``backward``.

        The arrays must not change until the next ``detach``: a device keeps its copy of them for a frame.
        """
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
        """Gradients of the Gaussians of the last ``draw`` (M), for the cotangent (3, H, W) of its picture.

        The cotangent is read in the tiles of ``met`` only; None means the gradient of the ``loss`` of that draw.
        """
        if v_rgb is None and self._evaluated:
            v_rgb = self._cotangent
        if self._drawn is None or v_rgb is None:
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        self._check_cotangent(v_rgb)
        moving, _ = self._drawn
        out = out or gradients_like(moving)
        cotangents = NativeCotangents(float_address(v_rgb), None, None, (ctypes.c_float * 3)(0, 0, 0))
        self._library.decogs_view_backward(
            self._kernel.handle,
            self._handle,
            ctypes.byref(self._scene),
            ctypes.byref(cotangents),
            ctypes.byref(out.native(moving)),
        )
        return out

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        """Makes everything static again: ``scene`` is the scene from now on, its ``rows`` were detached or are new.

        ``renumbered`` (N,) gives every old Gaussian's row in ``scene``, in the same order and none above the old one,
        -1 for one that is gone, which must have been detached; None when all kept theirs.
        """
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

    def centres(self) -> FloatArray:
        """Projected centres (N, 2) of the static scene, in pixels; NaN where a Gaussian is not drawn."""
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
        return NativePlanes(address(self._rgb), *more, (ctypes.c_float * 3)(0, 0, 0))

    def _checked_of(self, moving: Splats, rows: RowArray) -> RowArray:
        if len(moving) != len(rows):
            raise ValueError(f"{len(moving)} Gaussians for {len(rows)} rows")
        return checked_rows(rows, len(self._loaded()) + _MAX_NEW)

    def _check_marks(self, marks: NDArray[np.bool_] | None) -> None:
        size = (self.camera.height, self.camera.width)
        if marks is not None and (marks.shape != size or marks.dtype != np.bool_):
            raise ValueError(f"marks of {marks.dtype} {marks.shape} for a picture of {size}")

    def _check_cotangent(self, v_rgb: FloatArray) -> None:
        size = (3, self.camera.height, self.camera.width)
        if v_rgb.shape != size:
            raise ValueError(f"cotangent of shape {v_rgb.shape} for a picture of {size}")
