"""The training kernel on a CUDA device, through gsplat.

Run on an H100 with gsplat 1.5.3 and torch 2.11: every test passed, and steps were timed (report/gpu.md); the checks of
its arguments came after that run. Where there is no GPU, the tests run this file on CPU tensors with plain torch in
place of gsplat's four functions. Signatures and conventions are gsplat 1.5.3's, the same in 1.5.0:
``fully_fused_projection`` (not packed), ``isect_tiles``, ``isect_offset_encode``, and ``rasterize_to_pixels`` with its
tile ``masks``.

Chosen: a view keeps on the device how what rests projects, and projects only what changes. Both together, in the
scene's order, are listed by tile and composited in the tiles that a changing Gaussian meets or met at the last draw;
autograd goes back to the changing ones alone. A view's pictures, targets and pictures' gradients stay on the device
from ``draw`` to ``backward``. Stored values and their gradients travel, so that cache, densification and Adam
(inherited) are the native ones; so do the keyframe's pictures, whose loss is the native one too. Rejected: gsplat's
``rasterization`` (projects and draws everything) and ``SelectiveAdam`` (no bias correction); Adam on the device (values
and moments would travel both ways). Open, largest first
(measured): the loss, half of a sparse step, in some fifty passes of torch; the many small launches around gsplat's
kernels; pictures that travel in the keyframe; tile lists of what rests, sorted anew for every draw.

Differs from the native kernel: alpha ends at 0.999 instead of 0.99, so that a pixel in the core of a denser Gaussian is
off by up to 0.009 of the contrast to what is behind it; the tiles met are those of a Gaussian's box, some more than its
ellipse's; needles a thousand times as long as wide are off by some 2e-3 (gsplat's own twin on the CPU), since it takes
determinants as differences; sums run in no fixed order, so that the same seed gives other bits every time.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from decogs.decoder.rasterise.native import RowArray, check_renumbered, checked_rows
from decogs.decoder.rasterise.reference import BLUR, CLOSEST, sh_basis
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.splats import FloatArray, Splats, take_splats

from .fixed_view import FixedView
from .native import LossValue, Picture, SplatGradients, TrainingKernel, gradients_like
from .photometric import photometric_loss

_TILE = 16
_NEAREST = 1e-10
"""Stands for "in front of the camera" where a camera has no near plane; gsplat divides by the square of the depth."""
_STORED = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
_DEPTH, _ALPHA = 3, 4  # planes of a picture, after red, green and blue


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


class _Lens:
    """A pinhole camera as gsplat reads it."""

    def __init__(self, camera: Camera, device: torch.device) -> None:
        intrinsics = [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]
        self.width, self.height, self.near = camera.width, camera.height, max(camera.near, _NEAREST)
        self.columns, self.rows = -(-camera.width // _TILE), -(-camera.height // _TILE)
        self.pose = torch.tensor(camera.world_to_camera[None], dtype=torch.float32, device=device)
        self.intrinsics = torch.tensor([intrinsics], dtype=torch.float32, device=device)
        self.centre = torch.tensor(camera_centre(camera), dtype=torch.float32, device=device)

    def pixels(self, tiles: Tensor) -> Tensor:
        """Pixels (H, W) of tiles (rows, columns)."""
        grown = tiles.repeat_interleave(_TILE, 0).repeat_interleave(_TILE, 1)
        return grown[: self.height, : self.width]


class _Projected(NamedTuple):
    """N Gaussians on a picture. One whose radii are 0 is not drawn; its other values mean nothing and may be NaN."""

    means2d: Tensor  # (N, 2) pixels
    conics: Tensor  # (N, 3)
    depths: Tensor  # (N,)
    opacities: Tensor  # (N,) with the filter's compensation
    colours: Tensor  # (N, 4) red, green, blue, depth
    radii: Tensor  # (N, 2) int32, half size of the box in pixels

    @classmethod
    def blank(cls, count: int, device: torch.device) -> _Projected:
        """``count`` Gaussians that are not drawn."""
        tails = ((2,), (3,), (), (), (4,), (2,))
        values = [torch.zeros((count, *tail), device=device) for tail in tails]
        return cls(*values)._replace(radii=values[-1].int())

    @property
    def drawn(self) -> Tensor:
        return (self.radii > 0).all(1)

    def take(self, rows: Tensor) -> _Projected:
        return _Projected(*(values[rows] for values in self))

    def put(self, rows: Tensor, others: _Projected) -> _Projected:
        """These with ``others`` in place of ``rows``; a row beyond the last adds rows, which are not drawn before."""
        count = max(len(self.radii), int(rows.max()) + 1 if len(rows) else 0)
        room = _Projected.blank(count - len(self.radii), self.radii.device)
        return _Projected(
            *(
                torch.cat([mine, more]).index_copy(0, rows, new)
                for mine, more, new in zip(self, room, others, strict=True)
            )
        )


class _Lists(NamedTuple):
    """Pairs of a tile and a Gaussian by tile, front to back; equal depths in the scene's order."""

    tiles: Tensor  # (P,)
    gaussians: Tensor  # (P,) int32
    offsets: Tensor  # (1, rows, columns) int32, where a tile's pairs begin


@dataclass
class _Trace:
    """What the way back needs of a picture."""

    leaves: list[Tensor]
    projected: _Projected
    outputs: list[Tensor]

    def gradients(self, cotangents: list[Tensor], out: SplatGradients) -> SplatGradients:
        """Fills ``out``; rows that were not drawn get exactly zero."""
        if not len(self.leaves[0]):
            return out
        inputs = [*self.leaves, self.projected.means2d]
        found = torch.autograd.grad(self.outputs, inputs, cotangents, retain_graph=True)
        for name, gradient in zip((*_STORED, "view"), (*found[:-1], found[-1].norm(dim=1)), strict=True):
            drawn = self.projected.drawn.view(-1, *[1] * (gradient.ndim - 1))
            getattr(out, name)[...] = _host(torch.where(drawn, gradient, 0.0))
        return out


class CudaKernel(TrainingKernel):
    """The training kernel with pictures and gradients by gsplat on ``device``; its loss and Adam are the native ones.

    ``gsplat`` stands in for the module of that name: the tests run this class on the CPU.
    """

    def __init__(self, threads: int = 0, *, device: str = "cuda", gsplat: Any = None) -> None:
        super().__init__(threads)
        self.device = torch.device(device)
        self._gsplat = gsplat or importlib.import_module("gsplat")
        self._trace: _Trace | None = None

    def forward(
        self,
        splats: Splats,
        camera: Camera,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        *,
        sh_degree: int | None = None,
        depth: bool = False,
    ) -> Picture:
        lens, leaves = _Lens(camera, self.device), self.leaves(splats)
        degree = splats.sh_degree if sh_degree is None else min(sh_degree, splats.sh_degree)
        projected = self.project(leaves, lens, degree)
        planes = self.composite(projected, lens, self.tile_lists(projected, lens))
        behind = torch.tensor(background, device=self.device).view(3, 1, 1)
        rgb = planes[:3] + (1 - planes[_ALPHA]) * behind
        self._trace = _Trace(leaves, projected, [rgb, planes[_ALPHA], planes[_DEPTH]])
        return Picture(_host(rgb), _host(planes[_ALPHA]), _host(planes[_DEPTH]) if depth else None)

    def backward(
        self,
        splats: Splats,
        v_rgb: FloatArray,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> SplatGradients:
        if self._trace is None or len(splats) != len(self._trace.leaves[0]):
            raise ValueError("backward needs the scene of the last forward")
        outputs = self._trace.outputs
        given = (v_rgb, v_alpha, v_depth)
        cotangents = [
            torch.zeros_like(plane) if v is None else self.upload(v) for plane, v in zip(outputs, given, strict=True)
        ]
        return self._trace.gradients(cotangents, out or gradients_like(splats))

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        if self._trace is None or count != len(self._trace.leaves[0]):
            raise ValueError("centres needs the scene of the last forward")
        projected = self._trace.projected
        nowhere = torch.where(projected.drawn, 0.0, torch.nan)
        return _host(projected.means2d + nowhere[:, None]), _host(projected.depths + nowhere)

    def upload(self, values: NDArray[Any]) -> Tensor:
        """A copy on the device, never a view of the host's memory."""
        return torch.tensor(values, device=self.device)

    def leaves(self, splats: Splats) -> list[Tensor]:
        """Stored values on the device, ready to be differentiated by."""
        return [self.upload(getattr(splats, name)).requires_grad_() for name in _STORED]

    def project(self, stored: list[Tensor], lens: _Lens, sh_degree: int) -> _Projected:
        """Ellipses and colours of Gaussians by their stored values; conventions of kernel/project.h."""
        means, log_scales, quaternions, opacity_logits, sh = stored
        if not len(means):  # gsplat 1.5.3 divides by the number of Gaussians
            return _Projected.blank(0, self.device)
        scales, opacities = log_scales.exp(), opacity_logits.sigmoid()
        radii, means2d, depths, conics, compensations = self._gsplat.fully_fused_projection(
            means,
            None,
            _unit_quaternions(quaternions),
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
        near_enough = depths[0] >= CLOSEST * scales.detach().amax(1)
        directions = means - lens.centre
        basis = sh_basis(torch, sh_degree, directions / directions.norm(dim=1, keepdim=True))
        rgb = (0.5 + (basis[:, :, None] * sh[:, : basis.shape[1]]).sum(1)).relu()
        return _Projected(
            means2d[0],
            conics[0],
            depths[0],
            opacities * compensations[0],
            torch.cat([rgb, depths[0, :, None]], 1),
            torch.where(near_enough[:, None], radii[0], 0),
        )

    def tile_lists(self, projected: _Projected, lens: _Lens) -> _Lists:
        """Which tiles the Gaussians' boxes meet."""
        means2d, radii, depths = projected.means2d[None], projected.radii[None], projected.depths[None]
        _, keys, gaussians = self._gsplat.isect_tiles(means2d, radii, depths, _TILE, lens.columns, lens.rows)
        offsets = self._gsplat.isect_offset_encode(keys, 1, lens.columns, lens.rows)
        return _Lists(keys >> 32, gaussians, offsets)  # a key: image (0, there is one), tile, 32 bits of depth

    def composite(self, projected: _Projected, lens: _Lens, lists: _Lists, tiles: Tensor | None = None) -> Tensor:
        """Red, green, blue, depth and alpha, (5, H, W); undefined outside ``tiles`` (rows, columns) if given."""
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
        return torch.cat([colours[0], alphas[0]], 2).permute(2, 0, 1)


class CudaFixedView(FixedView):
    """A fixed view whose pictures stay on the device; ``rgb``, ``alpha``, ``depth`` and ``met`` are copies of them."""

    _trace: _Trace | None
    _gradient: Tensor | None
    _given: tuple[FloatArray | None, FloatArray | None, FloatArray | None]
    _uploaded: list[Tensor | None]

    def __init__(self, kernel: CudaKernel, camera: Camera) -> None:
        self._device_kernel, self.camera = kernel, camera
        self._lens = _Lens(camera, kernel.device)
        self._shown = torch.zeros((5, camera.height, camera.width), device=kernel.device)
        self._tiles_met = torch.zeros((self._lens.rows, self._lens.columns), dtype=torch.bool, device=kernel.device)
        self._stale = ~self._tiles_met  # tiles that do not show what rests, and nothing else
        self._lifted = np.zeros(0, np.bool_)
        self._resting = _Projected.blank(0, kernel.device)
        self._forget()

    @property
    def rgb(self) -> FloatArray:
        return _host(self._shown[:3])

    @property
    def alpha(self) -> FloatArray:
        return _host(self._shown[_ALPHA])

    @property
    def depth(self) -> FloatArray:
        return _host(self._shown[_DEPTH])

    @property
    def met(self) -> NDArray[np.uint8]:
        return np.asarray(self._tiles_met.cpu().numpy().ravel(), np.uint8)

    def place(self, scene: Splats) -> None:
        self._resting, self._lifted = self._projected(scene), np.zeros(len(scene), np.bool_)
        self._forget()

    def refresh(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        """As the native view's, but everything is drawn again, since the weights are gradients of the whole picture.

        A Gaussian's weight is the gradient of its red with a cotangent of 1 in every pixel, of its green with 1 in
        every marked one.
        """
        self._check_marks(marks)
        resting = self._resting._replace(colours=self._resting.colours.detach().requires_grad_())
        planes = self._device_kernel.composite(resting, self._lens, self._lists(resting))
        cotangent = torch.zeros_like(planes[:2])
        cotangent[0] = 1
        if marks is not None:
            cotangent[1] = self._device_kernel.upload(marks)
        (weights,) = torch.autograd.grad(planes[:2], resting.colours, cotangent)
        self._shown, self._stale = planes.detach(), torch.zeros_like(self._stale)
        return _host(weights[:, :2].T)

    def lift(self, rows: RowArray) -> None:
        rows = checked_rows(rows, len(self._placed()))
        lifted = self._device_kernel.upload(rows)
        self._stale = self._stale | self._tiles(self._lists(self._resting.take(lifted)).tiles)
        self._resting = self._resting._replace(radii=self._resting.radii.index_fill(0, lifted, 0))
        self._placed()[rows] = True
        self._forget()

    def draw(self, moving: Splats, rows: RowArray, *, depth: bool = False) -> None:
        """As the native view's; alpha and depth are always drawn along."""
        rows = self._checked_of(moving, rows)
        kernel, lens = self._device_kernel, self._lens
        where, leaves = kernel.upload(rows), kernel.leaves(moving)
        projected = kernel.project(leaves, lens, moving.sh_degree)
        whole = self._resting.put(where, projected)
        lists = self._lists(whole)
        moves = torch.zeros(len(whole.radii), dtype=torch.bool, device=kernel.device).index_fill(0, where, True)
        self._tiles_met = self._tiles(lists.tiles[moves[lists.gaussians]])
        shown = self._tiles_met | self._stale
        planes = kernel.composite(whole, lens, lists, shown)
        self._shown = torch.where(lens.pixels(shown), planes.detach(), self._shown)
        self._stale = self._tiles_met
        self._drawn, self._gradient = (moving, rows), None
        self._trace = _Trace(leaves, projected, [planes[:3]])

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
        on_device, weight, seen = self._uploaded
        assert on_device is not None
        value, self._gradient = photometric_loss(
            self._shown[:3],
            on_device,
            weight,
            seen,
            wanted=self._lens.pixels(self._tiles_met),
            l1_scale=l1_scale,
            ssim_scale=ssim_scale,
        )
        return value

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> SplatGradients:
        if v_rgb is not None:
            self._check_cotangent(v_rgb)
        cotangent = self._gradient if v_rgb is None else self._device_kernel.upload(v_rgb)
        if self._drawn is None or self._trace is None or cotangent is None:
            raise ValueError("backward needs a draw before it, and the draw's loss or a cotangent")
        return self._trace.gradients([cotangent], out or gradients_like(self._drawn[0]))

    def settle(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        rows = checked_rows(rows, len(scene))
        renumbered = check_renumbered(renumbered, self._placed(), len(scene))
        if renumbered is not None:
            kept = self._resting.take(self._device_kernel.upload(np.flatnonzero(renumbered >= 0)))
            blank = _Projected.blank(len(scene), self._device_kernel.device)
            self._resting = blank.put(self._device_kernel.upload(renumbered[renumbered >= 0]), kept)
        self._resting = self._resting.put(self._device_kernel.upload(rows), self._projected(take_splats(scene, rows)))
        self._lifted = np.zeros(len(scene), np.bool_)
        self._forget()

    def centres(self) -> FloatArray:
        nowhere = torch.where(self._resting.drawn, 0.0, torch.nan)
        return _host(self._resting.means2d + nowhere[:, None])

    def _forget(self) -> None:
        """What belongs to the frame before."""
        self._drawn, self._trace, self._gradient, self._given, self._uploaded = None, None, None, (None, None, None), []

    @torch.no_grad()
    def _projected(self, splats: Splats) -> _Projected:
        return self._device_kernel.project(self._device_kernel.leaves(splats), self._lens, splats.sh_degree)

    def _lists(self, projected: _Projected) -> _Lists:
        return self._device_kernel.tile_lists(projected, self._lens)

    def _tiles(self, found: Tensor) -> Tensor:
        """Numbers of tiles as a mask (rows, columns)."""
        mask = torch.zeros(self._lens.rows * self._lens.columns, dtype=torch.bool, device=found.device)
        return mask.index_fill(0, found, True).view(self._lens.rows, self._lens.columns)


def _unit_quaternions(quaternions: Tensor) -> Tensor:
    """Of unit length; a zero quaternion stands for no rotation."""
    norm = quaternions.norm(dim=1, keepdim=True)
    turned = norm > 1e-18
    upright = torch.tensor([1.0, 0.0, 0.0, 0.0], device=quaternions.device)
    return torch.where(turned, quaternions / torch.where(turned, norm, 1.0), upright)


def _host(values: Tensor) -> FloatArray:
    """A copy in the host's memory, C-contiguous."""
    return np.array(values.detach().cpu().numpy(), np.float32, order="C")
