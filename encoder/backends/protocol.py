"""The protocol of a backend: rendering with gradients, losses and Adam for training.

Gaussians under training, their gradients and Adam's moments stay where the backend keeps them. A step on a device
therefore waits for nothing. A number or an array of numpy was read, and reading waits for the device:
``Optimiser.splats``, ``Gradients.host``, a loss's ``total``, a picture's planes, ``ViewGradients.mean``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.native import RowArray
from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import BLACK as BLACK
from decogs.formats.colours.srgb import Colour as Colour
from decogs.formats.splats import FloatArray, Splats

from ..settings.optimiser import LearningRates

if TYPE_CHECKING:
    from typing_extensions import Self

ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
"""The stored values of a Gaussian, in the order of ``Splats``."""


class RenderedPicture(Protocol):
    """A rendering, planar."""

    @property
    def rgb(self) -> FloatArray:
        """Colours (3, H, W) float32, display-referred."""

    @property
    def alpha(self) -> FloatArray:
        """Opacity (H, W) float32, 0 to 1."""

    @property
    def depth(self) -> FloatArray | None:
        """Depth (H, W) float32 in world units, summed with the rendering weights; None where it was not rendered."""


class LossValue:
    """A picture's loss: ``total``, and its weighted sums of absolute differences and of 1 - SSIM.

    ``read`` brings both sums, when a number is first asked for.
    """

    def __init__(self, l1_scale: float, ssim_scale: float, read: Callable[[], Sequence[float]]) -> None:
        self._scales, self._read = (l1_scale, ssim_scale), read

    @cached_property
    def sums(self) -> tuple[float, float]:
        """Of absolute differences and of 1 - SSIM."""
        l1, ssim = self._read()
        return float(l1), float(ssim)

    @property
    def total(self) -> float:
        """The loss itself."""
        return self._scales[0] * self.sums[0] + self._scales[1] * self.sums[1]


@dataclass(frozen=True)
class SplatGradients:
    """Gradients of the stored values, shaped like them; ``view`` (N,): length of the projected centre's, in pixels."""

    means: FloatArray
    log_scales: FloatArray
    quaternions: FloatArray
    opacity_logits: FloatArray
    sh: FloatArray
    view: FloatArray

    def host(self) -> SplatGradients:
        """These: they are in the host's memory."""
        return self


def gradients_like(splats: Splats) -> SplatGradients:
    """Room for the gradients of ``splats``, to be reused from step to step."""
    shapes = [getattr(splats, name).shape for name in ATTRIBUTES] + [(len(splats),)]
    return SplatGradients(*(np.empty(shape, np.float32) for shape in shapes))


class Gradients(Protocol):
    """Gradients of a picture's Gaussians, where the backend has them; valid until the next backward pass."""

    def host(self) -> SplatGradients:
        """The same in the host's memory."""


class Optimiser(Protocol):
    """Gaussians under training, stepped in place by Adam; attributes are named as in ATTRIBUTES."""

    def __len__(self) -> int: ...

    @property
    def splats(self) -> Splats:
        """The values, N rows, to be read only: `put` changes them."""

    def step(
        self,
        gradients: Gradients,
        rates: LearningRates,
        *,
        max_stretch: float = 0.0,
        reach: FloatArray | None = None,
    ) -> None:
        """One step of every attribute whose rate is not 0; ``reach``: factors (N,) of how far the positions move.

        With ``max_stretch``, no Gaussian's largest size is then more than so many times its middle one, unless it was.
        """

    def put(self, rows: RowArray | None = None, **values: FloatArray) -> None:
        """Sets attributes, of ``rows`` or of all, to ``values``; momentum stays."""

    def freeze(self, frozen: Mapping[str, NDArray[np.bool_]]) -> None:
        """Keeps these values of each attribute as they are until rows come or go."""

    def gradient_size(self, name: str) -> FloatArray:
        """Root mean square of an attribute's gradients so far, shaped like it, the recent ones weighing most.

        It is the loss's sensitivity to a change. Before the first step, 0.
        """

    def keep(self, rows: NDArray[np.bool_] | RowArray) -> None:
        """Drops every other row, or puts rows into a new order."""

    def append(self, added: Splats) -> None:
        """Adds rows without momentum."""

    def copy(self) -> Self:
        """An independent optimiser with the same values and momentum; nothing is frozen."""

    def copy_momentum(self, other: Any, rows: RowArray, theirs: RowArray) -> None:
        """Takes over the momentum of an ``other`` of its kind: of its rows ``theirs`` for ``rows``."""


Drawable: TypeAlias = "Splats | Optimiser"
"""What can be drawn: values in the host's memory, which travel at every draw, or those under training, in place."""


class ViewGradients(Protocol):
    """Mean gradient of each Gaussian's projected centre over the views that drew it, in 3DGS's normalised units.

    3DGS measures it in coordinates that run from -1 to 1 over the picture, hence a factor of half the picture's size.
    """

    def add(self, gradients: Gradients, camera: Camera, emphasis: float = 1.0) -> None:
        """Takes the gradients of one view's loss, which weighs its pixels ``emphasis`` times as much as the plain one.

        A length of 0 means not drawn.
        """

    def mean(self) -> NDArray[np.float64]:
        """The mean (N,) over the views that drew each Gaussian; 0 for one that no view drew."""


class FixedView(Protocol):
    """The picture of a pinhole ``camera``, kept up to date while Gaussians change a few at a time.

    The order of calls: ``set_scene``; then for every frame ``refresh`` or ``redraw`` (as often as wanted), ``detach``
    the Gaussians that are about to change, ``draw`` and ``backward`` as often as wanted, ``commit``.

    ``rgb`` (3, H, W), ``alpha`` and ``depth`` (H, W; the depth summed by weight) are the picture as last drawn or
    redrawn; ``alpha`` and ``depth`` are those of the last redraw or of the last draw with ``depth``.

    After a scene that was refused (UsageError, MemoryError) the next call must be ``set_scene``.
    """

    camera: Camera

    @property
    def rgb(self) -> FloatArray:
        """The picture (3, H, W) float32, display-referred; the next ``draw`` writes over it."""

    @property
    def alpha(self) -> FloatArray:
        """Opacity (H, W) float32 of the picture, 0 to 1."""

    @property
    def depth(self) -> FloatArray:
        """Depth (H, W) float32 in world units, summed with the rendering weights."""

    @property
    def met(self) -> NDArray[np.uint8]:
        """One per 16x16 tile: whether a Gaussian of the last ``draw`` meets it. Nothing else can change its pixels."""

    def set_scene(self, scene: Splats) -> None:
        """Starts with a whole scene (N Gaussians), all of it static; the picture is there after ``refresh``."""

    def refresh(self) -> None:
        """Brings the picture up to date with the static scene."""

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        """`refresh`, and every Gaussian's rendering weight, (2, N).

        The weight is the sum of alpha times transmittance: in row 0 over all pixels, in row 1 over ``marks`` (H, W).
        """

    def detach(self, rows: RowArray) -> None:
        """Takes the Gaussians ``rows`` out of the static scene: they are what changes until ``commit``."""

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        """Brings the picture up to date with ``moving`` (M Gaussians) in it, which are the scene's ``rows``, ascending.

        Rows are detached ones, or new ones, numbered from N on. Detached ones that are left out are not drawn.
        """

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        """``TrainingKernel.picture_loss`` of the last ``draw`` in the tiles of ``met``; its gradient waits.

        The arrays must not change as long as they live: a device keeps its copy of them.
        """

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> Gradients:
        """Gradients of the Gaussians of the last ``draw`` (M), for the cotangent (3, H, W) of its picture.

        The cotangent is read in the tiles of ``met`` only; None means the gradient of the ``loss`` of that draw.
        With ``out``, they are put there.
        """

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        """Makes everything static again: ``scene`` is the scene from now on, its ``rows`` were detached or are new.

        ``renumbered`` (N,) gives every old Gaussian's row in ``scene``, in the same order and none above the old one,
        -1 for one that is gone, which must have been detached; None when all kept theirs.
        """

    def squared_error(self, picture: FloatArray, counted: FloatArray | None = None) -> float:
        """Sum of the squared differences of this view's picture, clipped to 0..1, from ``picture`` (3, H, W).

        ``counted`` (H, W) weighs the pixels. May be asked on any thread.
        """

    def centres(self) -> FloatArray:
        """Projected centres (N, 2) of the static scene, in pixels; NaN where a Gaussian is not drawn."""


class TrainingKernel(Protocol):
    """A backend: it renders with gradients, evaluates losses and steps Gaussians, all on one device.

    What no Gaussian covers shows the kernel's background, in its fixed views too; ``forward`` takes another.

    ``forward`` must come before ``picture_loss``, ``backward`` and ``centres``, with the same scene and camera.
    """

    background: Colour
    leaves_processor_idle: bool
    """Whether the processor can do other work while it trains."""

    def forward(
        self,
        splats: Drawable,
        camera: Camera,
        background: Colour | None = None,
        *,
        sh_degree: int | None = None,
        depth: bool = False,
    ) -> RenderedPicture:
        """Renders, and keeps what `backward` needs; raises UsageError when a scene covers the picture too often."""

    def picture_loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        """``l1_scale * sum(l1_weight |a-b|) + ssim_scale * sum(focus (1 - SSIM(focus a, focus b)))`` of the picture.

        Its gradient waits for ``backward``. Shapes: ``target`` (3, H, W); ``l1_weight`` and ``focus`` (H, W). The
        arrays must not change as long as they live: a device keeps its copy of them. Source: Wang 2004, Kerbl 2023
        eq. 7.
        """

    def bring(self, *arrays: FloatArray | None) -> None:
        """Starts to bring arrays of a coming loss to where it is evaluated; on any thread."""

    def backward(
        self,
        splats: Drawable,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> Gradients:
        """Gradients of every Gaussian for the cotangents of the last picture; without ``v_rgb``, for its loss.

        With ``out``, they are put there.
        """

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Projected centres (N, 2) in pixels and depths (N,) of the last picture; NaN where nothing was drawn."""

    def fixed_view(self, camera: Camera) -> FixedView:
        """A fixed view of the pinhole ``camera``."""

    def optimiser(self, splats: Splats, *, beta1: float = 0.9, beta2: float = 0.999) -> Optimiser:
        """A copy of ``splats``, ready to be trained by Adam (Kingma 2015)."""

    def view_gradients(self, count: int) -> ViewGradients:
        """Gathers the view gradients of ``count`` Gaussians."""
