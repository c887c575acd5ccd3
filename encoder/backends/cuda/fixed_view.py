"""A fixed camera on the device, which watches a scene of which few Gaussians change.

Chosen: it keeps on the device how every Gaussian projects, and projects again only what changes. All together, in the
scene's order, are listed by tile and composited in the tiles that a changing Gaussian meets or met at the last draw.
Open: static Gaussians are listed anew for every draw, which takes a tenth of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray, check_renumbered, checked_rows
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats

from ..arguments import check_cotangents, check_marks, rows_of
from ..protocol import Drawable, LossValue, SplatGradients
from .device import read, read_floats
from .gradients import DeviceGradients
from .splatting import Drawn, Lens, Lists, Planes, Stored, TilesToDraw, blank, centres, hide

if TYPE_CHECKING:
    from .cuda_kernel import CudaKernel


class Committed(NamedTuple):
    """A commit's new values and their rows; and rows that stay, their former and their new numbers, None for all."""

    stored: Stored
    rows: Tensor
    kept: tuple[Tensor, Tensor] | None


class CudaFixedView:
    """``FixedView`` whose pictures stay on the device; ``rgb``, ``alpha``, ``depth`` and ``met`` are copies of them."""

    _drawn: Drawn | None
    _gradient: Tensor | None
    _whole: Lists | None

    def __init__(self, kernel: CudaKernel, camera: Camera, recorded: NDArray[np.bool_] | None = None) -> None:
        check_marks(recorded, camera)
        self._kernel, self.camera, self._recorded = kernel, camera, recorded
        self._lens = Lens(camera, kernel.device)
        self._planes = Planes(camera, kernel.device, kernel.background)
        self._tiles = TilesToDraw(self._lens.tiles, kernel.device)
        self._travelled: FloatArray | None = None  # the host's copy of the colours
        self._detached = np.zeros(0, np.bool_)
        self._all = blank(0, kernel.device)  # what is static, as it was put; what changes, as last drawn
        self._forget()

    @property
    def rgb(self) -> FloatArray:
        if self._travelled is None:
            self._travelled = self._read(self._planes.rgb)
        return self._travelled

    @property
    def alpha(self) -> FloatArray:
        return self._read(1 - self._planes.transmittance)

    @property
    def depth(self) -> FloatArray:
        return self._read(self._planes.depth)

    @property
    def met(self) -> NDArray[np.uint8]:
        return np.asarray(read(self._tiles.met), np.uint8)

    def set_scene(self, scene: Splats) -> None:
        self._all = self._kernel.splatting.project(self._kernel.stored(scene), self._lens)
        self._detached = np.zeros(len(scene), np.bool_)
        self._tiles.stale.fill_(1)
        self._forget()

    def refresh(self) -> None:
        self._refreshed()

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        check_marks(marks, self.camera)
        if self._recorded is None:
            return read_floats(self._weights(marks).T)
        # The kernel's own sum counts what was not recorded, too.
        marked = np.zeros_like(self._recorded) if marks is None else marks & self._recorded
        return read_floats(torch.stack([self._weights(self._recorded)[:, 1], self._weights(marked)[:, 1]]))

    def _weights(self, marks: NDArray[np.bool_] | None) -> Tensor:
        """Every Gaussian's rendering weight, over all pixels and over ``marks``, (N, 2)."""
        on_device, lists = None if marks is None else self._kernel.upload(marks), self._refreshed()
        return self._kernel.splatting.weights(self._all, self._lens, lists, on_device)

    def _refreshed(self) -> Lists:
        """The lists of the whole scene, drawn unless the picture shows it already."""
        if self._whole is None:
            splatting = self._kernel.splatting
            self._whole = splatting.lists(self._all, self._lens, None, None)
            splatting.composite(self._all, self._lens, self._whole, self._planes)
            self._travelled = None
            self._tiles.stale.zero_()
        return self._whole

    def detach(self, rows: RowArray) -> None:
        if self._rows is not None:
            hide(self._all, self._where)
        rows = checked_rows(rows, len(self._detached))
        detached = self._kernel.upload(rows)
        self._kernel.splatting.mark_met(self._all, detached, self._lens, self._tiles.stale)
        hide(self._all, detached)
        self._detached[rows] = True
        self._forget()

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        """Alpha and depth are always drawn along."""
        rows = rows_of(moving, rows, len(self._detached))
        splatting, lens = self._kernel.splatting, self._lens
        stored, where = self._kernel.stored(moving), self._rows_on_device(rows)
        splatting.project(stored, lens, where, self._all)
        lists = splatting.lists(self._all, lens, where, self._tiles)
        splatting.composite(self._all, lens, lists, self._planes, self._tiles)
        self._travelled = self._gradient = self._whole = None
        self._drawn = Drawn(stored, where, self._all, lists, self._planes)

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        given = self._kernel.brought(target, l1_weight, focus)
        value, self._gradient = self._kernel.compare(self._planes.rgb, given, self._tiles.met, l1_scale, ssim_scale)
        return value

    def backward(
        self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None
    ) -> DeviceGradients | SplatGradients:
        cotangent = self._gradient
        if v_rgb is not None:
            check_cotangents((self.camera.height, self.camera.width), v_rgb)
            cotangent = self._kernel.upload(v_rgb)
        if self._drawn is None or cotangent is None:
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        splatting, lens = self._kernel.splatting, self._lens
        moments = splatting.moments(self._drawn, lens, (cotangent, None, None), self._changing, self._tiles)
        gradients = splatting.gradients(self._drawn, lens, moments)
        return gradients if out is None else gradients.put_into(out)

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        checked_rows(rows, len(scene))
        check_renumbered(renumbered, self._detached, len(scene))
        splatting, new = self._kernel.splatting, self._kernel.committed(scene, rows, renumbered)
        before, self._all = self._all, blank(len(scene), self._kernel.device)
        if new.kept is None:
            count = min(len(before), len(scene))
            self._all[:count] = before[:count]
        else:
            self._all.index_copy_(0, new.kept[1], before[new.kept[0]])
        splatting.project(new.stored, self._lens, new.rows, self._all)
        splatting.mark_met(self._all, new.rows, self._lens, self._tiles.stale)
        self._detached = np.zeros(len(scene), np.bool_)
        self._forget()

    def squared_error(self, picture: FloatArray, counted: FloatArray | None = None) -> float:
        target, weights = self._kernel.brought(picture, counted)
        assert target is not None
        square = (self._planes.rgb.clamp(0, 1) - target) ** 2
        if weights is not None:
            square = square * weights
        total = float(read(square.sum(dtype=torch.float64)))
        self._lens.room.check(self.camera)
        return total

    def centres(self) -> FloatArray:
        return read_floats(centres(self._all)[0])

    def _read(self, plane: Tensor) -> FloatArray:
        values = read_floats(plane)
        self._lens.room.check(self.camera)
        return values

    def _forget(self) -> None:
        """What belongs to the frame before."""
        self._drawn = self._gradient = self._whole = None
        self._rows: RowArray | None = None
        self._where = torch.zeros(0, dtype=torch.int64, device=self._kernel.device)  # the same rows on the device
        self._changing: Tensor | None = None  # the same as a mark for each Gaussian

    def _rows_on_device(self, rows: RowArray) -> Tensor:
        """``rows`` there, with room for all of them; what was drawn at other rows does not show any more."""
        if self._rows is not None and np.array_equal(rows, self._rows):
            return self._where
        device, count = self._kernel.device, max(len(self._detached), int(rows[-1]) + 1 if len(rows) else 0)
        if self._rows is not None:
            hide(self._all, self._where)
        if count > len(self._all):
            self._all = torch.cat([self._all, blank(count - len(self._all), device)])
        self._rows, self._where = rows.copy(), self._kernel.upload(rows)
        self._changing = torch.zeros(len(self._all), dtype=torch.uint8, device=device)
        self._changing.index_fill_(0, self._where, 1)
        return self._where
