"""Gaussians on a picture of a device: the kernels of kernel/splatting.cu, called in their order.

Everything is queued and nothing is read but, once in a while, how much room a picture's lists need (`Room`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from decogs.decoder.rasterise.native import MAX_PAIRS, NativeScene, check_drawn, native_camera
from decogs.formats.cameras import Camera
from decogs.formats.splats import sh_degree_of

from ..protocol import ATTRIBUTES, Colour
from .device import on_host
from .gradients import DeviceGradients
from .module import THREADS, Kernels

_TILE_PIXELS = 16
_FLOATS, _X, _Y, _CUT, _DEPTH = 16, 0, 1, 6, 7
"""Of a projected Gaussian (decoder/rasterise/kernel/project.h): their number, and places among them."""
_MOMENTS = 12
_FIRST_ROOM, _SPARE, _MORE_GAUSSIANS = 1 << 14, 2, 1.1
_COVERED = 1


class _Grid(ctypes.Structure):
    _fields_ = [("columns", ctypes.c_int32), ("rows", ctypes.c_int32)]


class _Needed(ctypes.Structure):
    _fields_ = [("met", ctypes.c_void_p), ("stale", ctypes.c_void_p)]


class _Lists(ctypes.Structure):
    _fields_ = [
        ("ends", ctypes.c_void_p),
        ("keys", ctypes.c_void_p),
        ("gaussians", ctypes.c_void_p),
        ("capacity", ctypes.c_int64),
    ]


class _Planes(ctypes.Structure):
    _fields_ = [
        ("rgb", ctypes.c_void_p),
        ("transmittance", ctypes.c_void_p),
        ("depth", ctypes.c_void_p),
        ("last", ctypes.c_void_p),
        ("background", ctypes.c_float * 3),
    ]


class _Pointers(ctypes.Structure):
    """Cotangents of a picture, and gradients of stored values: pointers alone."""

    @classmethod
    def to(cls, *tensors: Tensor | None) -> _Pointers:
        return cls(*(None if tensor is None else tensor.data_ptr() for tensor in tensors))


class _Cotangents(_Pointers):
    _fields_ = [(name, ctypes.c_void_p) for name in ("rgb", "alpha", "depth")]


class _Gradients(_Pointers):
    _fields_ = [(name, ctypes.c_void_p) for name in (*ATTRIBUTES, "view")]


class Room:
    """How many pairs the lists of a camera's pictures have room for: twice as many as were last seen.

    The device says how many there were where the host looks without waiting. It is waited for when the scene is new or
    has grown by a tenth: pairs double in no other way within the few steps that the device is behind. Pictures that had
    no room are not handed out (`check`).
    """

    def __init__(self, device: torch.device) -> None:
        self.seen = on_host(torch.zeros(1, dtype=torch.int64, device=device)).zero_()
        self._host = self.seen.numpy()
        self._gaussians, self._capacity = 0, 0

    def for_pairs(self, ends: Tensor, tiles: int, camera: Camera) -> int:
        """The capacity for these lists; raises UsageError for a scene that covers the picture too often."""
        count = len(ends) - tiles
        if not self._capacity or count > _MORE_GAUSSIANS * self._gaussians:
            self._host[0], self._gaussians = int(ends[tiles - 1]), count
        if self._host[0] > MAX_PAIRS:
            check_drawn(_COVERED, camera.width, camera.height)
        if _SPARE * self._host[0] > self._capacity:
            self._capacity = int(_SPARE * self._host[0])
        self._capacity = max(self._capacity, _FIRST_ROOM)
        return self._capacity

    def check(self, camera: Camera) -> None:
        """Raises UsageError where the last picture, which was waited for, had no room for all its pairs."""
        if self._host[0] > self._capacity:
            check_drawn(_COVERED, camera.width, camera.height)


class Lens:
    """A pinhole camera as the kernels read it."""

    def __init__(self, camera: Camera, device: torch.device) -> None:
        self.camera, self.native, self.room = camera, native_camera(camera), Room(device)
        self.columns, self.rows = -(-camera.width // _TILE_PIXELS), -(-camera.height // _TILE_PIXELS)
        self.tiles, self.grid = self.columns * self.rows, _Grid(self.columns, self.rows)


@dataclass(frozen=True)
class Stored:
    """Stored values of Gaussians on the device, in the order of ATTRIBUTES, and the degree of SH that is drawn."""

    tensors: Sequence[Tensor]
    sh_degree: int

    @classmethod
    def of(cls, tensors: Sequence[Tensor], limit: int | None = None) -> Stored:
        """With the degree that they have, or the ``limit`` if that is lower."""
        degree = sh_degree_of(tensors[-1].shape[1])
        return cls(tensors, degree if limit is None else min(limit, degree))

    def __len__(self) -> int:
        return len(self.tensors[0])

    def native(self) -> NativeScene:
        """For a kernel; the tensors must live until it is queued."""
        pointers = [tensor.data_ptr() for tensor in self.tensors]
        return NativeScene(len(self), self.tensors[-1].shape[1], self.sh_degree, *pointers)


@dataclass(frozen=True)
class Lists:
    """Pairs of a tile and a Gaussian, on the device."""

    ends: Tensor
    keys: Tensor
    gaussians: Tensor

    def native(self) -> _Lists:
        return _Lists(self.ends.data_ptr(), self.keys.data_ptr(), self.gaussians.data_ptr(), len(self.gaussians))


class Planes:
    """A picture on the device: colours (3, H, W), and per pixel transmittance, summed depth, and its last entry."""

    def __init__(self, camera: Camera, device: torch.device, background: Colour) -> None:
        size = (camera.height, camera.width)
        self.rgb = torch.zeros((3, *size), device=device)
        self.transmittance, self.depth = torch.ones(size, device=device), torch.zeros(size, device=device)
        self.last = torch.zeros(size, dtype=torch.int32, device=device)
        self._background = (ctypes.c_float * 3)(*background)

    def native(self) -> _Planes:
        pointers = [tensor.data_ptr() for tensor in (self.rgb, self.transmittance, self.depth, self.last)]
        return _Planes(*pointers, self._background)


class TilesToDraw:
    """Which tiles of a picture are drawn, one byte each: those that a changing Gaussian meets, and stale ones."""

    def __init__(self, tiles: int, device: torch.device) -> None:
        self.met = torch.zeros(tiles, dtype=torch.uint8, device=device)
        self.stale = torch.zeros_like(self.met)

    def native(self) -> _Needed:
        return _Needed(self.met.data_ptr(), self.stale.data_ptr())


@dataclass(frozen=True)
class Drawn:
    """A picture's trace: what the way back needs. ``all``: the projected scene; ``rows``: what ``stored`` is in it."""

    stored: Stored
    rows: Tensor | None
    all: Tensor
    lists: Lists
    planes: Planes


class Splatting:
    """Draws through a camera, and back, on a device."""

    def __init__(self, kernels: Kernels, device: torch.device) -> None:
        self.kernels, self._device = kernels, device

    def project(self, stored: Stored, lens: Lens, rows: Tensor | None = None, into: Tensor | None = None) -> Tensor:
        """The projected Gaussians (N, 16), or with these in place of ``rows``."""
        if into is None:
            into = torch.empty((len(stored), _FLOATS), device=self._device)
        if len(stored):
            self.kernels.launch("project", _blocks(len(stored)), stored.native(), lens.native, rows, into)
        return into

    def mark_met(self, projected: Tensor, rows: Tensor, lens: Lens, marks: Tensor) -> None:
        """Marks the tiles that these ``rows`` meet."""
        if len(rows):
            self.kernels.launch("meet", _blocks(32 * len(rows)), projected, rows, len(rows), lens.grid, marks)

    def lists(self, projected: Tensor, lens: Lens, changing: Tensor | None, tiles: TilesToDraw | None) -> Lists:
        """Of all tiles, or of those that a ``changing`` row meets, which is marked, and of stale ones."""
        launch, count, needed = self.kernels.launch, len(projected), _Needed() if tiles is None else tiles.native()
        counts = torch.empty(lens.tiles + count, dtype=torch.int32, device=self._device)
        launch("begin", _blocks(lens.tiles), lens.grid, None if tiles is None else tiles.met, counts)
        if tiles is not None and changing is not None:
            self.mark_met(projected, changing, lens, tiles.met)
        blocks = _blocks(32 * count)
        launch("count_pairs", blocks, projected, count, lens.grid, needed, counts)
        ends = torch.cumsum(counts, 0, dtype=torch.int64)
        capacity = lens.room.for_pairs(ends, lens.tiles, lens.camera)
        keys = torch.empty(capacity, dtype=torch.int64, device=self._device)
        lists = Lists(ends, keys, torch.empty(capacity, dtype=torch.int32, device=self._device))
        native = lists.native()
        launch("list_pairs", blocks, projected, count, lens.grid, needed, counts, native, lens.room.seen)
        launch("sort_tiles", (lens.tiles,), native)
        return lists

    def composite(
        self, projected: Tensor, lens: Lens, lists: Lists, planes: Planes, tiles: TilesToDraw | None = None
    ) -> None:
        """Draws the tiles; stale are then those that show changing Gaussians."""
        needed = _Needed() if tiles is None else tiles.native()
        arguments = (lens.native, lens.grid, projected, lists.native(), needed, planes.native())
        self.kernels.launch("composite", (lens.tiles,), *arguments)

    def moments(
        self,
        drawn: Drawn,
        lens: Lens,
        by: Sequence[Tensor | None],
        changing: Tensor | None = None,
        tiles: TilesToDraw | None = None,
    ) -> Tensor:
        """Sums (M, 12) over the pixels for the Gaussians of ``drawn``, for cotangents of colours, alpha and depth."""
        lists = drawn.lists.native()
        moments = torch.empty((len(drawn.lists.gaussians), _MOMENTS), device=self._device)
        met = None if tiles is None else tiles.met
        arguments = (drawn.all, lists, met, changing, drawn.planes.native(), _Cotangents.to(*by), moments)
        self.kernels.launch("backward", (lens.tiles,), lens.native, lens.grid, *arguments)
        return self._gathered(lens, drawn.lists, moments, drawn.rows, len(drawn.stored))

    def weights(self, projected: Tensor, lens: Lens, lists: Lists, marks: Tensor | None) -> Tensor:
        """Every Gaussian's rendering weight, over all pixels and over ``marks``, (N, 2)."""
        weights = torch.empty((len(lists.gaussians), 2), device=self._device)
        arguments = (lens.native, lens.grid, projected, lists.native(), marks, weights)
        self.kernels.launch("weigh", (lens.tiles,), *arguments)
        return self._gathered(lens, lists, weights, None, len(projected))

    def _gathered(self, lens: Lens, lists: Lists, values: Tensor, rows: Tensor | None, count: int) -> Tensor:
        """What the pairs of Gaussians have, summed."""
        numbers = values.shape[1]
        totals = torch.empty((count, numbers), device=self._device)
        if count:
            arguments = (lists.native(), values, numbers, totals)
            self.kernels.launch("gather", _blocks(16 * count), rows, count, lens.tiles, *arguments)
        return totals

    def gradients(self, drawn: Drawn, lens: Lens, moments: Tensor) -> DeviceGradients:
        """Of the stored values, from `moments`; zero for what is not drawn."""
        gradients = DeviceGradients.room_for(drawn.stored.tensors)
        if len(drawn.stored):
            native = _Gradients.to(*gradients.tensors.values())
            arguments = (drawn.stored.native(), lens.native, drawn.rows, drawn.all, moments, native)
            self.kernels.launch("backward_project", _blocks(len(drawn.stored)), *arguments)
        return gradients


def blank(count: int, device: torch.device) -> Tensor:
    """``count`` projected Gaussians that are not drawn."""
    return torch.zeros((count, _FLOATS), device=device)


def hide(projected: Tensor, rows: Tensor) -> None:
    """These rows are not drawn any more."""
    projected[:, _CUT].index_fill_(0, rows, 0)


def centres(projected: Tensor) -> tuple[Tensor, Tensor]:
    """Projected centres (N, 2) and depths (N,); NaN where a Gaussian is not drawn."""
    nowhere = torch.where(projected[:, _CUT] > 0, 0.0, torch.nan)
    return projected[:, [_X, _Y]] + nowhere[:, None], projected[:, _DEPTH] + nowhere


def _blocks(threads: int) -> tuple[int]:
    """Blocks that have so many threads, one at least."""
    return (max(1, -(-threads // THREADS)),)
