"""The training kernel on a CUDA device, through gsplat.

Signatures and conventions are gsplat 1.5.3's, the same in 1.5.0: ``fully_fused_projection`` (not packed),
``spherical_harmonics``, ``isect_tiles``, ``isect_offset_encode``, and ``rasterize_to_pixels`` with its tile ``masks``.
Run on an H100 and an H200 (report/gpu.md). On the CPU the tests run all of this with plain torch in place of gsplat's
functions and of the fused loss.

Chosen: a view keeps on the device how every Gaussian projects, and projects again only what changes. All together, in
the scene's order, are listed by tile and composited in the tiles that a changing Gaussian meets or met at the last
draw. Gradients go back in two steps, through the compositing of all and through the projection of the changing ones
alone, and travel as one block. Pictures, targets and pictures' gradients stay on the device; a picture travels when
somebody looks at it. Stored values travel, so that cache, densification and Adam (inherited) are the native ones.
Rejected: gsplat's ``rasterization`` (projects and draws everything) and ``SelectiveAdam`` (no bias correction); Adam on
the device (measured: of 10 ms a step of 150 000 Gaussians it and both ways take 4). Open: tile lists of static
Gaussians are sorted anew for every draw.

Differs from the native kernel: alpha ends at 0.999 instead of 0.99, so that a pixel in the core of a denser Gaussian is
off by up to 0.009 of the contrast to what is behind it; the tiles met are those of a Gaussian's box, some more than its
ellipse's; needles a thousand times as long as wide are off by some 2e-3 (gsplat's own twin on the CPU), since it takes
determinants as differences; sums run in no fixed order, so that the same seed gives other bits every time.
"""

from __future__ import annotations

import importlib
import weakref
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray, check_renumbered, checked_rows
from decogs.decoder.rasterise.reference import BLUR, CLOSEST
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.splats import FloatArray, Splats, take_splats

from ..cpu.fixed_view import FixedView
from ..cpu.native import LossValue, RenderedPicture, SplatGradients, TrainingKernel, gradients_like
from .photometric import TiledLoss

_TILE = 16
_NEAREST = 1e-10
"""Stands for "in front of the camera" where a camera has no near plane; gsplat divides by the square of the depth."""
_STORED = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
_DEPTH = 3  # channel of the colours, after red, green and blue

LossMaker = Callable[[int, int, torch.device], Any]
"""Makes the loss of pictures of a width and height on a device: ``photometric.TiledLoss``, or the fused one."""


def missing_for_cuda() -> str | None:
    """What keeps this machine from training on CUDA, in words; None when nothing is known to."""
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} finds no CUDA device"
    try:
        backend = importlib.import_module("gsplat.cuda._backend")
    except Exception as error:  # gsplat compiles itself when first imported, which may fail in any way
        return f"gsplat cannot be imported ({str(error).splitlines()[0] if str(error) else type(error).__name__})"
    if getattr(backend, "_C", backend) is None:
        return "gsplat has no compiled kernels and finds no CUDA toolkit (nvcc) to compile them"
    return None


def _loss_on(device: torch.device) -> LossMaker:
    """The fused loss where there is a GPU, its readable twin elsewhere."""
    if device.type != "cuda":
        return TiledLoss
    from .photometric_fused import FusedLoss

    return FusedLoss


class _Lens:
    """A pinhole camera as gsplat reads it."""

    def __init__(self, camera: Camera, device: torch.device) -> None:
        intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
        self.width, self.height, self.near = camera.width, camera.height, max(camera.near, _NEAREST)
        self.columns, self.rows = -(-camera.width // _TILE), -(-camera.height // _TILE)
        self.pose = torch.tensor(camera.world_to_camera[None], dtype=torch.float32, device=device)
        self.intrinsics = torch.tensor([intrinsics], dtype=torch.float32, device=device)
        self.centre = torch.tensor(camera_centre(camera), dtype=torch.float32, device=device)

    @cached_property
    def tile_of(self) -> Tensor:
        """The number of every pixel's tile, (H, W, 1)."""
        device = self.pose.device
        row, column = torch.arange(self.height, device=device), torch.arange(self.width, device=device)
        return ((row // _TILE)[:, None] * self.columns + (column // _TILE)[None])[..., None]

    def pixels(self, tiles: Tensor) -> Tensor:
        """Pixels (H, W, 1) of tiles (rows, columns)."""
        return tiles.view(-1)[self.tile_of]


class _Projected(NamedTuple):
    """N Gaussians on a picture. One whose radii are 0 is not drawn; its other values mean nothing and may be NaN."""

    means2d: Tensor  # (N, 2) pixels
    conics: Tensor  # (N, 3)
    opacities: Tensor  # (N,) with the filter's compensation
    colours: Tensor  # (N, 4) red, green, blue, depth
    depths: Tensor  # (N,)
    radii: Tensor  # (N, 2) int32, half size of the box in pixels

    @classmethod
    def blank(cls, count: int, device: torch.device) -> _Projected:
        """``count`` Gaussians that are not drawn."""
        values = [torch.zeros((count, *tail), device=device) for tail in ((2,), (3,), (), (4,), (), (2,))]
        return cls(*values)._replace(radii=values[-1].int())

    @property
    def drawn(self) -> Tensor:
        return (self.radii > 0).all(1)

    def take(self, rows: Tensor | slice) -> _Projected:
        return _Projected(*(values[rows] for values in self))

    def with_room(self, count: int) -> _Projected:
        """These, and after them as many that are not drawn as make ``count``."""
        more = _Projected.blank(count - len(self.radii), self.radii.device)
        return _Projected(*(torch.cat(pair) for pair in zip(self, more, strict=True)))

    def write(self, rows: Tensor, others: _Projected) -> None:
        """Puts ``others`` in place of ``rows``."""
        for mine, new in zip(self, others, strict=True):
            mine.index_copy_(0, rows, new.detach())

    def leaves(self) -> _Projected:
        """The same values, ready to be differentiated by."""
        floats = [values.detach().requires_grad_() for values in self[:4]]
        return _Projected(floats[0], floats[1], floats[2], floats[3], self.depths, self.radii)


class _Lists(NamedTuple):
    """Pairs of a tile and a Gaussian by tile, front to back; equal depths in the scene's order."""

    tiles: Tensor  # (P,)
    gaussians: Tensor  # (P,) int32
    offsets: Tensor  # (1, rows, columns) int32, where a tile's pairs begin


class _DevicePicture:
    """A picture on the device; a plane travels when it is first asked for."""

    def __init__(self, rgb: Tensor, alpha: Tensor, depth: Tensor | None) -> None:
        self._rgb, self._alpha, self._depth = rgb, alpha, depth

    @cached_property
    def rgb(self) -> FloatArray:
        return _host(self._rgb.permute(2, 0, 1))

    @cached_property
    def alpha(self) -> FloatArray:
        return _host(self._alpha[..., 0])

    @cached_property
    def depth(self) -> FloatArray | None:
        return None if self._depth is None else _host(self._depth)


class _Resident:
    """Copies on the device of arrays of the host, each as long as its array lives; the array must not change."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._copies: dict[int, tuple[weakref.ref[NDArray[Any]], Tensor]] = {}

    def of(self, values: NDArray[Any] | None) -> Tensor | None:
        if values is None:
            return None
        known = self._copies.get(id(values))
        if known is not None and known[0]() is values:
            return known[1]
        key, copies = id(values), self._copies
        copy = torch.tensor(values, device=self._device)
        copies[key] = (weakref.ref(values, lambda _: copies.pop(key, None)), copy)
        return copy


class CudaKernel(TrainingKernel):
    """The training kernel with pictures, loss and gradients on ``device``; Adam and ``loss`` are the native ones.

    ``gsplat`` stands in for the module of that name: the tests run this class on the CPU.
    """

    def __init__(self, threads: int = 0, *, device: str = "cuda", gsplat: Any = None) -> None:
        super().__init__(threads)
        self.device = torch.device(device)
        self._loss_maker = _loss_on(self.device)
        self._losses: dict[tuple[int, int], Any] = {}
        self._gsplat = gsplat or importlib.import_module("gsplat")
        self._resident = _Resident(self.device)
        self._drawn: tuple[list[Tensor], _Projected, _Projected, Tensor, Tensor, Tensor] | None = None
        self._gradient: Tensor | None = None
        self._part: tuple[Splats, RowArray, list[Tensor]] | None = None

    def forward(
        self,
        splats: Splats,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        sh_degree: int | None = None,
        depth: bool = False,
    ) -> RenderedPicture:
        lens, leaves = _Lens(camera, self.device), self.leaves(splats)
        degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
        projected = self.project(leaves, lens, degree)
        inputs = projected.leaves()
        colours, alphas = self.composite(inputs, lens, self.tile_lists(projected, lens))
        rgb = colours[..., :3]
        if any(background):
            rgb = rgb + (1 - alphas) * torch.tensor(background, device=self.device)
        self._drawn, self._gradient = (leaves, projected, inputs, rgb, alphas, colours[..., _DEPTH]), None
        return _DevicePicture(rgb.detach(), alphas.detach(), colours[..., _DEPTH].detach() if depth else None)

    def picture_loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        if self._drawn is None:
            raise ValueError("picture_loss needs a forward before it")
        rgb = self._drawn[3].detach()
        given = [self._resident.of(a) for a in (target, l1_weight, focus)]
        value, gradient = self.loss_of(rgb, given, None, l1_scale, ssim_scale)
        self._gradient = gradient[..., :3]
        return value

    def loss_of(
        self, image: Tensor, given: list[Tensor | None], wanted: Tensor | None, l1_scale: float, ssim_scale: float
    ) -> tuple[LossValue, Tensor]:
        """The loss of ``image`` (H, W, C >= 3) against target, weight of L1 and focus, all on the device.

        Summed over the tiles ``wanted`` (rows, columns), or all; with its gradient (H, W, 4).
        """
        size = (image.shape[1], image.shape[0])
        if size not in self._losses:
            self._losses[size] = self._loss_maker(*size, self.device)
        sums, gradient = self._losses[size](image, *given, wanted=wanted, l1_scale=l1_scale, ssim_scale=ssim_scale)
        return LossValue(l1_scale * sums.l1 + ssim_scale * sums.dissimilarity, *sums), gradient

    def backward(
        self,
        splats: Splats,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> SplatGradients:
        if self._drawn is None or len(splats) != len(self._drawn[0][0]):
            raise ValueError("backward needs the scene of the last forward")
        leaves, projected, inputs, rgb, alphas, depths = self._drawn
        cotangent = self._gradient if v_rgb is None else self.upload(v_rgb).permute(1, 2, 0)
        if cotangent is None:
            raise ValueError("backward needs a cotangent, or the loss of the last picture")
        outputs, cotangents = [rgb], [cotangent]
        if v_alpha is not None:
            outputs, cotangents = [*outputs, alphas], [*cotangents, self.upload(v_alpha)[..., None]]
        if v_depth is not None:
            outputs, cotangents = [*outputs, depths], [*cotangents, self.upload(v_depth)]
        out = out or gradients_like(splats)
        if len(splats):
            found = torch.autograd.grad(outputs, inputs[:4], cotangents, retain_graph=True)
            self.gradients(leaves, projected, found, out)
        return out

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        if self._drawn is None or count != len(self._drawn[0][0]):
            raise ValueError("centres needs the scene of the last forward")
        projected = self._drawn[1]
        nowhere = torch.where(projected.drawn, 0.0, torch.nan)
        return _host(projected.means2d + nowhere[:, None]), _host(projected.depths + nowhere)

    def upload(self, values: NDArray[Any]) -> Tensor:
        """A copy on the device, never a view of the host's memory."""
        return torch.tensor(values, device=self.device)

    def leaves(self, splats: Splats) -> list[Tensor]:
        """Stored values on the device, ready to be differentiated by."""
        return [self.upload(getattr(splats, name)).requires_grad_() for name in _STORED]

    def part(self, scene: Splats, rows: RowArray) -> list[Tensor]:
        """Stored values of a scene's ``rows`` on the device; they travel once for all views that ask in a row."""
        if self._part is None or self._part[0] is not scene or self._part[1] is not rows:
            self._part = scene, rows, self.leaves(take_splats(scene, rows))
        return self._part[2]

    def gradients(
        self, leaves: list[Tensor], projected: _Projected, by: tuple[Tensor, ...], out: SplatGradients
    ) -> None:
        """Fills ``out`` from gradients ``by`` the projected values; rows that were not drawn get exactly zero."""
        found = torch.autograd.grad(projected[:4], leaves, by, retain_graph=True)
        drawn, blocks = projected.drawn, []
        for gradient in (*found, by[0].norm(dim=1)):
            mask = drawn.view(-1, *[1] * (gradient.ndim - 1))
            blocks.append(torch.where(mask, gradient, 0.0).flatten())
        block, at = torch.cat(blocks).cpu().numpy(), 0
        for name in (*_STORED, "view"):
            values = getattr(out, name)
            values.reshape(-1)[:] = block[at : at + values.size]
            at += values.size

    def project(self, stored: list[Tensor], lens: _Lens, sh_degree: int) -> _Projected:
        """Ellipses and colours of Gaussians by their stored values; conventions of kernel/project.h."""
        means, log_scales, quaternions, opacity_logits, sh = stored
        if not len(means):  # gsplat 1.5.3 divides by the number of Gaussians
            return _Projected.blank(0, self.device)
        scales, opacities = log_scales.exp(), opacity_logits.sigmoid()
        radii, means2d, depths, conics, compensations = self._gsplat.fully_fused_projection(
            means,
            None,
            _turned_somehow(quaternions),
            scales,
            lens.pose,
            lens.intrinsics,
            lens.width,
            lens.height,
            eps2d=BLUR,
            near_plane=lens.near,
            packed=False,
            calc_compensations=True,
            opacities=opacities.detach(),
        )
        near_enough = depths[0].detach() >= CLOSEST * scales.detach().amax(1)
        rgb = (0.5 + self._gsplat.spherical_harmonics(sh_degree, means - lens.centre, sh)).relu()
        return _Projected(
            means2d[0],
            conics[0],
            opacities * compensations[0],
            torch.cat([rgb, depths[0, :, None]], 1),
            depths[0].detach(),
            torch.where(near_enough[:, None], radii[0], 0),
        )

    def tile_lists(self, projected: _Projected, lens: _Lens) -> _Lists:
        """Which tiles the Gaussians' boxes meet."""
        means2d, radii, depths = projected.means2d.detach()[None], projected.radii[None], projected.depths[None]
        _, keys, gaussians = self._gsplat.isect_tiles(means2d, radii, depths, _TILE, lens.columns, lens.rows)
        offsets = self._gsplat.isect_offset_encode(keys, 1, lens.columns, lens.rows)
        return _Lists(keys >> 32, gaussians, offsets)  # a key: image (0, there is one), tile, 32 bits of depth

    def composite(
        self, projected: _Projected, lens: _Lens, lists: _Lists, tiles: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Red, green, blue, depth (H, W, 4), alpha (H, W, 1); undefined outside ``tiles`` (rows, columns) if given."""
        colours, alphas = self._gsplat.rasterize_to_pixels(
            projected.means2d[None],
            projected.conics[None],
            projected.colours[None],
            projected.opacities[None],
            lens.width,
            lens.height,
            _TILE,
            lists.offsets,
            lists.gaussians,
            masks=None if tiles is None else tiles[None],
        )
        return colours[0], alphas[0]


class CudaFixedView(FixedView):
    """A fixed view whose pictures stay on the device; ``rgb``, ``alpha``, ``depth`` and ``met`` are copies of them."""

    _trace: tuple[list[Tensor], _Projected, _Projected, Tensor, Tensor] | None
    _gradient: Tensor | None
    _given: tuple[FloatArray | None, FloatArray | None, FloatArray | None]
    _uploaded: list[Tensor | None]

    def __init__(self, kernel: CudaKernel, camera: Camera) -> None:
        self._device_kernel, self.camera = kernel, camera
        self._lens = _Lens(camera, kernel.device)
        self._colours = torch.zeros((camera.height, camera.width, 4), device=kernel.device)
        self._alphas = torch.zeros((camera.height, camera.width, 1), device=kernel.device)
        self._tiles_met = torch.zeros((self._lens.rows, self._lens.columns), dtype=torch.bool, device=kernel.device)
        self._travelled: tuple[Tensor, FloatArray] | None = None  # colours, and the host's copy of them
        self._stale = ~self._tiles_met  # tiles that do not show what is static, and nothing else
        self._detached = np.zeros(0, np.bool_)
        self._all = _Projected.blank(0, kernel.device)  # what is static, as it was put; what changes, as last drawn
        self._changing: Tensor | None = None
        self._forget()

    @property
    def rgb(self) -> FloatArray:
        if self._travelled is None or self._travelled[0] is not self._colours:
            self._travelled = self._colours, _host(self._colours[..., :3].permute(2, 0, 1))
        return self._travelled[1]

    @property
    def alpha(self) -> FloatArray:
        return _host(self._alphas[..., 0])

    @property
    def depth(self) -> FloatArray:
        return _host(self._colours[..., _DEPTH])

    @property
    def met(self) -> NDArray[np.uint8]:
        return np.asarray(self._tiles_met.cpu().numpy().ravel(), np.uint8)

    def set_scene(self, scene: Splats) -> None:
        stored = self._device_kernel.leaves(scene)
        self._all, self._detached = self._projected(stored, scene.sh_degree), np.zeros(len(scene), np.bool_)
        self._forget()

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        """As the native view's, but everything is drawn again, since the weights are gradients of the whole picture.

        A Gaussian's weight is the gradient of its red with a cotangent of 1 in every pixel, of its green with 1 in
        every marked one.
        """
        self._check_marks(marks)
        inputs = self._all.leaves()
        colours, alphas = self._device_kernel.composite(inputs, self._lens, self._lists(inputs))
        cotangent = torch.zeros_like(colours)
        cotangent[..., 0] = 1
        if marks is not None:
            cotangent[..., 1] = self._device_kernel.upload(marks)
        (weights,) = torch.autograd.grad(colours, inputs.colours, cotangent)
        self._colours, self._alphas = colours.detach(), alphas.detach()
        self._stale = torch.zeros_like(self._stale)
        return _host(weights[:, :2].T)

    def detach(self, rows: RowArray) -> None:
        if self._rows is not None:
            self._all.radii.index_fill_(0, self._where, 0)
        rows = checked_rows(rows, len(self._loaded()))
        detached = self._device_kernel.upload(rows)
        self._stale = self._stale | self._tiles(self._lists(self._all.take(detached)).tiles)
        self._all.radii.index_fill_(0, detached, 0)
        self._loaded()[rows] = True
        self._forget()

    def draw(self, moving: Splats, rows: RowArray, *, depth: bool = False) -> None:
        """As the native view's; alpha and depth are always drawn along."""
        rows = self._checked_of(moving, rows)
        kernel, lens = self._device_kernel, self._lens
        leaves = kernel.leaves(moving)
        where = self._rows_on_device(rows)
        projected = kernel.project(leaves, lens, moving.sh_degree)
        self._all.write(where, projected)
        inputs = self._all.leaves()
        lists = self._lists(inputs)
        assert self._changing is not None
        self._tiles_met = self._met_by(lists, self._changing)
        shown = self._tiles_met | self._stale
        colours, alphas = kernel.composite(inputs, lens, lists, shown)
        pixels = lens.pixels(shown)
        self._colours = torch.where(pixels, colours.detach(), self._colours)
        self._alphas = torch.where(pixels, alphas.detach(), self._alphas)
        self._stale = self._tiles_met
        self._drawn, self._gradient = (moving, rows), None
        self._trace = (leaves, projected, inputs, colours, where)

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
            self._uploaded = [None if a is None else self._device_kernel.upload(a) for a in given]
        value, self._gradient = self._device_kernel.loss_of(
            self._colours, self._uploaded, self._tiles_met, l1_scale, ssim_scale
        )
        return value

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> SplatGradients:
        if v_rgb is not None:
            self._check_cotangent(v_rgb)
        if self._drawn is None or self._trace is None or (v_rgb is None and self._gradient is None):
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        leaves, projected, inputs, colours, where = self._trace
        out = out or gradients_like(self._drawn[0])
        if not len(leaves[0]):
            return out
        cotangent = self._gradient
        if v_rgb is not None:
            cotangent = torch.zeros_like(colours)
            cotangent[..., :3] = self._device_kernel.upload(v_rgb).permute(1, 2, 0)
        found = torch.autograd.grad(colours, inputs[:4], cotangent, retain_graph=True)
        self._device_kernel.gradients(leaves, projected, tuple(values[where] for values in found), out)
        return out

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        kernel, asked, rows = self._device_kernel, rows, checked_rows(rows, len(scene))
        renumbered = check_renumbered(renumbered, self._loaded(), len(scene))
        if renumbered is not None:
            kept = self._all.take(kernel.upload(np.flatnonzero(renumbered >= 0)))
            self._all = _Projected.blank(len(scene), kernel.device)
            self._all.write(kernel.upload(renumbered[renumbered >= 0]), kept)
        else:
            self._all = self._all.take(slice(0, len(scene))).with_room(len(scene))
        self._all.write(kernel.upload(rows), self._projected(kernel.part(scene, asked), scene.sh_degree))
        self._detached = np.zeros(len(scene), np.bool_)
        self._forget()

    def centres(self) -> FloatArray:
        nowhere = torch.where(self._all.drawn, 0.0, torch.nan)
        return _host(self._all.means2d + nowhere[:, None])

    def _forget(self) -> None:
        """What belongs to the frame before."""
        self._drawn, self._trace, self._gradient, self._given, self._uploaded = None, None, None, (None, None, None), []
        self._rows: RowArray | None = None
        self._where: Tensor = self._all.radii[:0, 0]  # the same rows on the device

    def _rows_on_device(self, rows: RowArray) -> Tensor:
        """``rows`` there, with room for all of them; what was drawn at other rows does not show any more."""
        if self._rows is not None and np.array_equal(rows, self._rows):
            return self._where
        kernel, count = self._device_kernel, max(len(self._loaded()), int(rows[-1]) + 1 if len(rows) else 0)
        if self._rows is not None:
            self._all.radii.index_fill_(0, self._where, 0)
        if count > len(self._all.radii):
            self._all = self._all.with_room(count)
        self._rows, self._where = rows.copy(), kernel.upload(rows)
        self._changing = torch.zeros(len(self._all.radii), dtype=torch.int32, device=kernel.device)
        self._changing.index_fill_(0, self._where, 1)
        return self._where

    @torch.no_grad()
    def _projected(self, stored: list[Tensor], sh_degree: int) -> _Projected:
        return self._device_kernel.project(stored, self._lens, sh_degree)

    def _lists(self, projected: _Projected) -> _Lists:
        return self._device_kernel.tile_lists(projected, self._lens)

    def _met_by(self, lists: _Lists, changing: Tensor) -> Tensor:
        """The tiles (rows, columns) with a pair whose Gaussian is marked as ``changing`` (N,)."""
        met = torch.zeros(self._lens.rows * self._lens.columns, dtype=torch.int32, device=changing.device)
        met.scatter_reduce_(0, lists.tiles, changing[lists.gaussians], "amax")
        return (met > 0).view(self._lens.rows, self._lens.columns)

    def _tiles(self, found: Tensor) -> Tensor:
        """Numbers of tiles as a mask (rows, columns)."""
        mask = torch.zeros(self._lens.rows * self._lens.columns, dtype=torch.bool, device=found.device)
        return mask.index_fill(0, found, True).view(self._lens.rows, self._lens.columns)


def _turned_somehow(quaternions: Tensor) -> Tensor:
    """No rotation in place of a zero quaternion; gsplat brings the others to unit length."""
    zero = quaternions.detach().abs().amax(1, keepdim=True) < 1e-18
    upright = functional.pad(torch.ones_like(quaternions[:, :1]), (0, 3))  # made there: nothing travels
    return torch.where(zero, upright, quaternions)


def _host(values: Tensor) -> FloatArray:
    """A copy in the host's memory, C-contiguous."""
    return np.asarray(values.detach().contiguous().to("cpu", copy=True).numpy(), np.float32)
