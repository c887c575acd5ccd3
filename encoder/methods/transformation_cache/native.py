"""The transformation cache's arithmetic: the C++ kernel with its buffers, arrays in and arrays out."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray
from decogs.formats.system.kernels import check_memory, checked_handle, load_kernel

from ...backends.cpu.native import AdamStep
from .weights import CacheConfig

GRADIENT_LIMIT = 1e6
"""Gradients handed in are clipped to it: far above any real one, so that no square overflows."""


class _Shape(ctypes.Structure):
    _fields_ = [
        *[(n, ctypes.c_int32) for n in ("levels", "features", "table_log2", "hidden_layers", "hidden_width")],
        ("resolutions", ctypes.c_void_p),
        ("low", ctypes.c_double * 3),
        ("high", ctypes.c_double * 3),
        ("translation_scale", ctypes.c_float),
        ("gradient_limit", ctypes.c_float),
    ]


class _Trained(ctypes.Structure):
    _fields_ = [(name, ctypes.c_void_p) for name in ("value", "first", "second")]


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    library = load_kernel(Path(__file__).parent, "_cache", [_Shape, AdamStep, _Trained])
    pointer, array, count = ctypes.POINTER, ctypes.c_void_p, ctypes.c_int64
    library.decogs_cache_create.restype = array
    library.decogs_cache_create.argtypes = [pointer(_Shape), ctypes.c_int]
    library.decogs_cache_destroy.argtypes = [array]
    for name in ("place", "base", "read", "moved", "backward", "gradients", "step"):
        library[f"decogs_cache_{name}"].restype = check_memory
    library.decogs_cache_place.argtypes = [array, count, array, pointer(count)]
    library.decogs_cache_entries.argtypes = [array, array]
    library.decogs_cache_base.argtypes = [array, count, array, array]
    library.decogs_cache_read.argtypes = [array, array]
    library.decogs_cache_moved.argtypes = [array, array, array, array]
    library.decogs_cache_backward.argtypes = [array, array, array, array, array]
    library.decogs_cache_gradients.argtypes = [array, array, array]
    trained = pointer(_Trained)
    library.decogs_cache_step.argtypes = [array, pointer(AdamStep), ctypes.c_float, trained, trained]
    return library


class Parameters:
    """Parameters under Adam (Kingma 2015): the values and both moments, float32 arrays of one shape."""

    def __init__(self, value: FloatArray) -> None:
        self.value = np.ascontiguousarray(value, np.float32)
        self.first, self.second = np.zeros_like(self.value), np.zeros_like(self.value)

    def native(self) -> _Trained:
        """The same as the kernel reads it; the arrays stay theirs."""
        return _Trained(*(array.ctypes.data for array in (self.value, self.first, self.second)))


class CacheKernel:
    """One cache's arithmetic with its thread pool and buffers; results do not depend on the number of threads.

    Order of calls: ``place``, ``base``, then ``read``, ``move``, ``backward``, ``step``. ``step`` reads
    the grid again, so that ``move`` may follow it at once.
    """

    def __init__(
        self, config: CacheConfig, low: NDArray[np.float64], high: NDArray[np.float64], extent: float, threads: int
    ) -> None:
        self._library = _library()
        resolutions = np.array(config.resolutions(), np.int32)
        shape = _Shape(
            config.levels,
            config.features,
            config.table_log2,
            config.hidden_layers,
            config.hidden_width,
            resolutions.ctypes.data,
            (ctypes.c_double * 3)(*low),
            (ctypes.c_double * 3)(*high),
            config.translation_scale * extent,
            GRADIENT_LIMIT,
        )
        self._handle = checked_handle(self._library.decogs_cache_create(ctypes.byref(shape), threads))
        self._count = 0

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self._library.decogs_cache_destroy(self._handle)

    def place(self, means: FloatArray) -> NDArray[np.int64]:
        """Fixes where the grid is read; returns the table entries (R,) read there, ascending over all levels."""
        entry_count = ctypes.c_int64()
        self._library.decogs_cache_place(self._handle, len(means), means.ctypes.data, ctypes.byref(entry_count))
        entries = np.empty(entry_count.value, np.int64)
        self._library.decogs_cache_entries(self._handle, entries.ctypes.data)
        return entries

    def base(self, means: FloatArray, quaternions: FloatArray) -> None:
        """Takes the values (M, 3) and (M, 4) that `move` starts from."""
        self._count = len(means)
        self._library.decogs_cache_base(self._handle, len(means), means.ctypes.data, quaternions.ctypes.data)

    def read(self, rows: Parameters) -> None:
        """Reads the grid's features from ``rows`` (R, features)."""
        self._library.decogs_cache_read(self._handle, rows.value.ctypes.data)

    def move(self, head: Parameters) -> tuple[FloatArray, FloatArray]:
        """Means (M, 3) and unit quaternions (M, 4) as the network ``head`` moves them."""
        means, quaternions = np.empty((self._count, 3), np.float32), np.empty((self._count, 4), np.float32)
        self._library.decogs_cache_moved(
            self._handle, head.value.ctypes.data, means.ctypes.data, quaternions.ctypes.data
        )
        return means, quaternions

    def backward(self, v_means: FloatArray, v_quaternions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gathers the parameters' gradients through the last `move`; returns those of the base values."""
        v_means, v_quaternions = (np.ascontiguousarray(v, np.float32) for v in (v_means, v_quaternions))
        base = np.empty_like(v_means), np.empty_like(v_quaternions)
        self._library.decogs_cache_backward(
            self._handle, v_means.ctypes.data, v_quaternions.ctypes.data, *(a.ctypes.data for a in base)
        )
        return base

    def gradients(self, rows: Parameters, head: Parameters) -> tuple[FloatArray, FloatArray]:
        """The gradients gathered, shaped like the parameters."""
        gathered = np.empty_like(rows.value), np.empty_like(head.value)
        self._library.decogs_cache_gradients(self._handle, *(a.ctypes.data for a in gathered))
        return gathered

    def step(self, adam: AdamStep, rate: float, rows: Parameters, head: Parameters) -> None:
        """One Adam step in place with the gradients gathered, and reads the grid again."""
        self._library.decogs_cache_step(
            self._handle, ctypes.byref(adam), rate, ctypes.byref(rows.native()), ctypes.byref(head.native())
        )
