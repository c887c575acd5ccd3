"""A fixed camera's picture, kept up to date while few Gaussians of its scene change from frame to frame.

Static Gaussians are neither projected, nor sorted, nor drawn again; pictures have the bits of ``render``. Design and
rejected alternatives: kernel/incremental_view.h. Training builds on the same kernel, see ``decogs.encoder.backends``.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats
from decogs.formats.system.kernels import checked_handle

from .native import (
    MAX_PAIRS,
    NativePicture,
    NativePlanes,
    RowArray,
    check_drawn,
    check_renumbered,
    checked_rows,
    native_camera,
    native_scene,
    renderer,
)


class IncrementalView:
    """The picture of a pinhole ``camera``: ``set_scene``, then ``change`` frame by frame; ``redraw`` draws.

    After a scene that was refused (UsageError, MemoryError) the next call must be ``set_scene``.

    ``image`` (H, W, 3), ``alpha`` and ``depth`` (H, W) are those of a Rendering, as of the last ``redraw``: the same
    read-only arrays all the time, whose pixels change. ``threads`` 0 means all processors.
    """

    def __init__(self, camera: Camera, background: tuple[float, float, float], *, threads: int = 0) -> None:
        self._renderer = renderer(threads)
        self._library = self._renderer.kernel
        height, width = camera.height, camera.width
        self._rgb = np.empty((3, height, width), np.float32)
        self._depth_sum = np.empty((height, width), np.float32)
        image = np.empty((height, width, 3), np.float32)
        alpha, depth = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
        self._planes = NativePlanes(
            self._rgb.ctypes.data,
            alpha.ctypes.data,
            self._depth_sum.ctypes.data,
            (ctypes.c_float * 3)(*background),
        )
        self._picture = NativePicture(image.ctypes.data, depth.ctypes.data)
        self.image, self.alpha, self.depth = _seen(image), _seen(alpha), _seen(depth)
        self._population: int | None = 0
        self._max_pairs = MAX_PAIRS
        self._handle = checked_handle(self._library.decogs_incremental_create(ctypes.byref(native_camera(camera))))

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self._library.decogs_incremental_destroy(self._handle)

    def allow(self, max_pairs: int) -> None:
        """From now on, scenes with more than ``max_pairs`` of a 16x16 tile and a Gaussian that meet are refused."""
        self._max_pairs = min(max_pairs, MAX_PAIRS)
        self._library.decogs_incremental_allow(self._handle, self._max_pairs)

    def set_scene(self, scene: Splats) -> None:
        """Starts anew with a whole scene (N Gaussians)."""
        native = native_scene(scene)
        self._population = None
        self._check(self._run(self._library.decogs_incremental_set_scene, ctypes.byref(native)))
        self._population = len(scene)

    def change(
        self,
        detached: RowArray,
        changed: Splats,
        rows: RowArray,
        *,
        population: int,
        renumbered: RowArray | None = None,
    ) -> None:
        """Takes the rows ``detached`` out of the scene and puts ``changed`` (M Gaussians) in at ``rows`` (M,).

        Both ascend; ``rows`` are those of the scene of ``population`` Gaussians that it is then. ``renumbered`` (N,)
        gives every former row's new one, in the same order and none above the former, -1 for detached ones that are
        gone; None when all kept theirs.
        """
        before = self._loaded()
        detached, rows = checked_rows(detached, before), checked_rows(rows, population)
        if len(changed) != len(rows):
            raise ValueError(f"{len(changed)} Gaussians for {len(rows)} rows")
        gone = np.zeros(before, np.bool_)
        gone[detached] = True
        renumbered = check_renumbered(renumbered, gone, population)
        committed = native_scene(changed)
        self._population = None
        status = self._run(
            self._library.decogs_incremental_change,
            detached.ctypes.data,
            len(detached),
            ctypes.byref(committed),
            rows.ctypes.data,
            population,
            None if renumbered is None else renumbered.ctypes.data,
            before,
        )
        self._check(status)
        self._population = population

    def redraw(self) -> int:
        """Redraws the 16x16 tiles that do not show the scene; returns how many there were."""
        self._loaded()
        drawn = ctypes.c_int64()
        self._run(
            self._library.decogs_incremental_redraw,
            ctypes.byref(self._planes),
            ctypes.byref(self._picture),
            ctypes.byref(drawn),
        )
        return drawn.value

    def _loaded(self) -> int:
        if self._population is None:
            raise ValueError("the last scene was refused; place one first")
        return self._population

    def _check(self, status: int) -> None:
        height, width = self.alpha.shape
        check_drawn(status, width, height, self._max_pairs)

    def _run(self, function: Callable[..., Any], *arguments: object) -> Any:
        return self._renderer.run(function, self._handle, *arguments)


def _seen(array: FloatArray) -> FloatArray:
    """The same pixels, not to be written."""
    view: NDArray[np.float32] = array.view()
    view.flags.writeable = False
    return view
