"""A fixed camera on the device, which watches a scene of which few Gaussians change.

Chosen: it keeps on the device how every Gaussian projects, and projects again only what changes. All together, in the
scene's order, are listed by tile and composited in the tiles that a changing Gaussian meets or met at the last draw.
Open: tile lists of static Gaussians are sorted anew for every draw.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray, check_renumbered, checked_rows
from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats, sh_degree_of

from ..arguments import check_cotangents, check_marks, rows_of
from ..protocol import Drawable, LossValue, SplatGradients
from .device import read, read_floats
from .gradients import DeviceGradients
from .projection import DEPTH, Lens, Lists, Projected, back_to

if TYPE_CHECKING:
    from .cuda_kernel import CudaKernel


class CudaFixedView:
    """``FixedView`` whose pictures stay on the device; ``rgb``, ``alpha``, ``depth`` and ``met`` are copies of them."""

    _trace: tuple[list[Tensor], Projected, Projected, Tensor, Tensor] | None
    _gradient: Tensor | None
    _given: tuple[FloatArray | None, FloatArray | None, FloatArray | None]
    _uploaded: list[Tensor | None]

    def __init__(self, kernel: CudaKernel, camera: Camera) -> None:
        self._kernel, self.camera = kernel, camera
        self._lens = Lens(camera, kernel.device)
        self._colours = torch.zeros((camera.height, camera.width, 4), device=kernel.device)
        self._alphas = torch.zeros((camera.height, camera.width, 1), device=kernel.device)
        self._tiles_met = torch.zeros((self._lens.rows, self._lens.columns), dtype=torch.bool, device=kernel.device)
        self._travelled: tuple[Tensor, FloatArray] | None = None  # colours, and the host's copy of them
        self._stale = ~self._tiles_met  # tiles that do not show what is static, and nothing else
        self._detached = np.zeros(0, np.bool_)
        self._all = Projected.blank(0, kernel.device)  # what is static, as it was put; what changes, as last drawn
        self._changing: Tensor | None = None
        self._forget()

    @property
    def rgb(self) -> FloatArray:
        if self._travelled is None or self._travelled[0] is not self._colours:
            self._travelled = self._colours, read_floats(self._colours[..., :3].permute(2, 0, 1))
        return self._travelled[1]

    @property
    def alpha(self) -> FloatArray:
        return read_floats(self._alphas[..., 0])

    @property
    def depth(self) -> FloatArray:
        return read_floats(self._colours[..., DEPTH])

    @property
    def met(self) -> NDArray[np.uint8]:
        return np.asarray(read(self._tiles_met).ravel(), np.uint8)

    def set_scene(self, scene: Splats) -> None:
        stored = self._kernel.leaves(scene)
        self._all, self._detached = self._projected(stored), np.zeros(len(scene), np.bool_)
        self._forget()

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        """Everything is drawn again, since the weights are gradients of the whole picture.

        A Gaussian's weight is the gradient of its red with a cotangent of 1 in every pixel, of its green with 1 in
        every marked one.
        """
        check_marks(marks, self.camera)
        inputs = self._all.leaves()
        colours, alphas = self._composited(inputs, self._lists(inputs))
        cotangent = torch.zeros_like(colours)
        cotangent[..., 0] = 1
        if marks is not None:
            cotangent[..., 1] = self._kernel.upload(marks)
        (weights,) = torch.autograd.grad(colours, inputs.colours, cotangent)
        self._colours, self._alphas = colours.detach(), alphas.detach()
        self._stale = torch.zeros_like(self._stale)
        return read_floats(weights[:, :2].T)

    def detach(self, rows: RowArray) -> None:
        if self._rows is not None:
            self._all.radii.index_fill_(0, self._where, 0)
        rows = checked_rows(rows, len(self._detached))
        detached = self._kernel.upload(rows)
        self._stale = self._stale | self._tiles(self._lists(self._all.take(detached)).tiles)
        self._all.radii.index_fill_(0, detached, 0)
        self._detached[rows] = True
        self._forget()

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        """Alpha and depth are always drawn along."""
        rows = rows_of(moving, rows, len(self._detached))
        kernel, lens = self._kernel, self._lens
        leaves = kernel.leaves(moving)
        where = self._rows_on_device(rows)
        projected = kernel.splatting.project(leaves, lens, sh_degree_of(leaves[-1].shape[1]))
        self._all.write(where, projected)
        inputs = self._all.leaves()
        lists = self._lists(inputs)
        assert self._changing is not None
        self._tiles_met = self._met_by(lists, self._changing)
        needed = self._tiles_met | self._stale
        colours, alphas = self._composited(inputs, lists, needed)
        pixels = lens.pixels(needed)
        self._colours = torch.where(pixels, colours.detach(), self._colours)
        self._alphas = torch.where(pixels, alphas.detach(), self._alphas)
        self._stale = self._tiles_met
        self._gradient, self._trace = None, (leaves, projected, inputs, colours, where)

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        given = (target, l1_weight, focus)
        if any(a is not b for a, b in zip(given, self._given, strict=True)):
            self._given = given
            self._uploaded = [None if a is None else self._kernel.upload(a) for a in given]
        value, self._gradient = self._kernel.loss_of(
            self._colours, self._uploaded, self._tiles_met, l1_scale, ssim_scale
        )
        return value

    def backward(
        self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None
    ) -> DeviceGradients | SplatGradients:
        cotangent = self._gradient
        if v_rgb is not None:
            check_cotangents((self.camera.height, self.camera.width), v_rgb)
            cotangent = torch.zeros_like(self._colours)
            cotangent[..., :3] = self._kernel.upload(v_rgb).permute(1, 2, 0)
        if self._trace is None or cotangent is None:
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        leaves, projected, inputs, colours, where = self._trace
        by = back_to(inputs, [colours], [cotangent])
        found = projected.gradients(leaves, [values[where] for values in by])
        return found if out is None else found.put_into(out)

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        kernel, asked, rows = self._kernel, rows, checked_rows(rows, len(scene))
        renumbered = check_renumbered(renumbered, self._detached, len(scene))
        if renumbered is not None:
            kept = self._all.take(kernel.upload(np.flatnonzero(renumbered >= 0)))
            self._all = Projected.blank(len(scene), kernel.device)
            self._all.write(kernel.upload(renumbered[renumbered >= 0]), kept)
        else:
            self._all = self._all.take(slice(0, len(scene))).with_room(len(scene))
        self._all.write(kernel.upload(rows), self._projected(kernel.part(scene, asked)))
        self._detached = np.zeros(len(scene), np.bool_)
        self._forget()

    def centres(self) -> FloatArray:
        nowhere = torch.where(self._all.drawn, 0.0, torch.nan)
        return read_floats(self._all.means2d + nowhere[:, None])

    def _composited(self, inputs: Projected, lists: Lists, needed: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Colours over the background and depths, (H, W, 4), and alphas."""
        colours, alphas = self._kernel.splatting.composite(inputs, self._lens, lists, needed)
        rgb = self._kernel.over_background(colours[..., :3], alphas, self._kernel.background)
        return torch.cat([rgb, colours[..., DEPTH:]], dim=-1), alphas

    def _forget(self) -> None:
        """What belongs to the frame before."""
        self._trace, self._gradient, self._given, self._uploaded = None, None, (None, None, None), []
        self._rows: RowArray | None = None
        self._where: Tensor = self._all.radii[:0, 0]  # the same rows on the device

    def _rows_on_device(self, rows: RowArray) -> Tensor:
        """``rows`` there, with room for all of them; what was drawn at other rows does not show any more."""
        if self._rows is not None and np.array_equal(rows, self._rows):
            return self._where
        kernel, count = self._kernel, max(len(self._detached), int(rows[-1]) + 1 if len(rows) else 0)
        if self._rows is not None:
            self._all.radii.index_fill_(0, self._where, 0)
        if count > len(self._all.radii):
            self._all = self._all.with_room(count)
        self._rows, self._where = rows.copy(), kernel.upload(rows)
        self._changing = torch.zeros(len(self._all.radii), dtype=torch.int32, device=kernel.device)
        self._changing.index_fill_(0, self._where, 1)
        return self._where

    @torch.no_grad()
    def _projected(self, stored: list[Tensor]) -> Projected:
        return self._kernel.splatting.project(stored, self._lens, sh_degree_of(stored[-1].shape[1]))

    def _lists(self, projected: Projected) -> Lists:
        return self._kernel.splatting.tile_lists(projected, self._lens)

    def _met_by(self, lists: Lists, changing: Tensor) -> Tensor:
        """The tiles (rows, columns) with a pair whose Gaussian is marked as ``changing`` (N,)."""
        met = torch.zeros(self._lens.rows * self._lens.columns, dtype=torch.int32, device=changing.device)
        met.scatter_reduce_(0, lists.tiles, changing[lists.gaussians], "amax")
        return (met > 0).view(self._lens.rows, self._lens.columns)

    def _tiles(self, found: Tensor) -> Tensor:
        """Numbers of tiles as a mask (rows, columns)."""
        mask = torch.zeros(self._lens.rows * self._lens.columns, dtype=torch.bool, device=found.device)
        return mask.index_fill(0, found, True).view(self._lens.rows, self._lens.columns)
