"""Training through very wide pinholes, face by face, as the decoder draws them (``decogs.decoder.rasterise.faces``).

Losses are taken in the faces' pictures: what a wide pinhole stretches at its border counts there as often as it was
recorded. Everything else, masks and selection too, sees the wide picture, put together.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.faces import Face, faces_of
from decogs.decoder.rasterise.native import RowArray
from decogs.formats.cameras import Camera, project
from decogs.formats.splats import FloatArray, Splats

from .cpu.native import tile_count
from .protocol import Colour, Drawable, FixedView, Gradients, LossValue, RenderedPicture, SplatGradients, TrainingKernel
from .tiles import tiles_with

if TYPE_CHECKING:
    from .protocol import Optimiser, ViewGradients


@dataclass(frozen=True)
class _FaceLoss:
    """A face's target (3, H, W) and its pixels' weights (H, W) in the absolute differences and in SSIM."""

    target: FloatArray
    l1_weight: FloatArray
    focus: FloatArray


class _Parts:
    """A wide camera's faces, and what losses against wide pictures are in them."""

    def __init__(self, camera: Camera) -> None:
        self.camera, self.faces = camera, faces_of(camera)
        self._kept: dict[tuple[int, ...], tuple[list[Any], list[_FaceLoss], float]] = {}

    def losses(
        self, target: FloatArray, l1_weight: FloatArray | None, focus: FloatArray | None
    ) -> tuple[list[_FaceLoss], float]:
        """One for each face, and how many pixels of the wide picture count for one of theirs; kept as arrays live."""
        arrays = [array for array in (target, l1_weight, focus) if array is not None]
        key = tuple(id(array) for array in (target, l1_weight, focus))
        if key not in self._kept:
            made = [self._loss(face, target, l1_weight, focus) for face in self.faces]
            there = sum(float(each.l1_weight.sum()) for each in made)
            wide = float(target[0].size if l1_weight is None else l1_weight.sum())
            forget = [weakref.ref(array, partial(self._forget, key)) for array in arrays]
            self._kept[key] = forget, made, wide / max(there, 1e-9)
        return self._kept[key][1:]

    def _forget(self, key: tuple[int, ...], _: object) -> None:
        self._kept.pop(key, None)

    def _loss(
        self, face: Face, target: FloatArray, l1_weight: FloatArray | None, focus: FloatArray | None
    ) -> _FaceLoss:
        def weight(plane: FloatArray | None) -> FloatArray:
            shown = face.shown.astype(np.float32)
            return shown if plane is None else np.ascontiguousarray(face.of(plane) * face.marks(plane > 0), np.float32)

        seen = face.of(np.ascontiguousarray(target.transpose(1, 2, 0)))
        return _FaceLoss(np.ascontiguousarray(seen.transpose(2, 0, 1)), weight(l1_weight), weight(focus))

    def together(self, planes: Sequence[FloatArray], *, depth: bool = False) -> FloatArray:
        """The wide plane (H, W) or planes (3, H, W) of those of the faces."""
        channels = planes[0].shape[:-2]
        whole = np.zeros((self.camera.height, self.camera.width, *channels), np.float32)
        for face, plane in zip(self.faces, planes, strict=True):
            face.put(np.ascontiguousarray(np.moveaxis(plane, 0, -1) if channels else plane), whole, depth=depth)
        return np.ascontiguousarray(np.moveaxis(whole, -1, 0) if channels else whole)

    def centres(self, splats: Splats, drawn: Sequence[NDArray[np.bool_]]) -> tuple[FloatArray, FloatArray]:
        """Projected centres (N, 2) in the wide picture and depths (N,); NaN where no face has ``drawn`` them (N,)."""
        u, v, depth = project(self.camera, splats.means)
        places = np.stack([u, v, depth], axis=1).astype(np.float32)
        places[~np.logical_or.reduce(drawn)] = np.nan
        return places[:, :2], places[:, 2]


class _WidePicture:
    """A wide rendering, drawn when a plane is first asked for."""

    def __init__(self, parts: _Parts, draw: Callable[[Camera], RenderedPicture]) -> None:
        self._parts, self._draw = parts, draw
        self._planes: tuple[FloatArray, FloatArray, FloatArray | None] | None = None

    @property
    def rgb(self) -> FloatArray:
        return self._drawn[0]

    @property
    def alpha(self) -> FloatArray:
        return self._drawn[1]

    @property
    def depth(self) -> FloatArray | None:
        return self._drawn[2]

    @property
    def _drawn(self) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        if self._planes is None:
            seen = []
            for face in self._parts.faces:
                picture = self._draw(face.camera)
                seen.append(tuple(None if p is None else p.copy() for p in (picture.rgb, picture.alpha, picture.depth)))
            rgb, alpha, depth = zip(*seen, strict=True)
            together = self._parts.together
            self._planes = together(rgb), together(alpha), None if depth[0] is None else together(depth, depth=True)
        return self._planes


class WideKernel:
    """A `TrainingKernel` that draws very wide pinholes face by face, and others as the ``kernel`` within it does."""

    def __init__(self, kernel: TrainingKernel) -> None:
        self._kernel = kernel
        self.background: Colour = kernel.background
        self.leaves_processor_idle = kernel.leaves_processor_idle
        self._cameras: dict[int, tuple[Any, _Parts]] = {}
        self._wide: tuple[_Parts, Drawable, Callable[..., RenderedPicture]] | None = None
        self._gradients: SplatGradients | None = None

    def forward(
        self,
        splats: Drawable,
        camera: Camera,
        background: Colour | None = None,
        *,
        sh_degree: int | None = None,
        depth: bool = False,
        tiles: NDArray[np.uint8] | None = None,
    ) -> RenderedPicture:
        parts = self._parts(camera)
        if not parts.faces:
            self._wide = None
            return self._kernel.forward(splats, camera, background, sh_degree=sh_degree, depth=depth, tiles=tiles)

        def draw(seen_by: Camera, tiles: NDArray[np.uint8] | None = None) -> RenderedPicture:
            return self._kernel.forward(splats, seen_by, background, sh_degree=sh_degree, depth=depth, tiles=tiles)

        self._wide, self._gradients = (parts, splats, draw), None
        return _WidePicture(parts, draw)

    def picture_loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        if self._wide is None:
            return self._kernel.picture_loss(
                target, l1_scale=l1_scale, ssim_scale=ssim_scale, l1_weight=l1_weight, focus=focus
            )
        parts, splats, draw = self._wide
        losses, factor = parts.losses(target, l1_weight, focus)
        values, gradients = [], _Sum()
        for face, loss in zip(parts.faces, losses, strict=True):
            if loss.l1_weight.any():
                draw(face.camera, tiles_with(loss.l1_weight > 0))
                values.append(_evaluated(self._kernel.picture_loss, loss, factor * l1_scale, factor * ssim_scale))
                gradients.add(self._kernel.backward(splats))
        self._gradients = gradients.total
        return _sum_of(values)

    def bring(self, *arrays: FloatArray | None) -> None:
        self._kernel.bring(*arrays)

    def backward(
        self,
        splats: Drawable,
        v_rgb: FloatArray | None = None,
        *,
        v_alpha: FloatArray | None = None,
        v_depth: FloatArray | None = None,
        out: SplatGradients | None = None,
    ) -> Gradients:
        """Of a wide picture: of its loss alone."""
        if self._wide is None:
            return self._kernel.backward(splats, v_rgb, v_alpha=v_alpha, v_depth=v_depth, out=out)
        if self._gradients is None or v_rgb is not None:
            raise ValueError("of a very wide picture only its loss has gradients; evaluate it first")
        return self._gradients

    def centres(self, count: int) -> tuple[FloatArray, FloatArray]:
        if self._wide is None:
            return self._kernel.centres(count)
        parts, splats, draw = self._wide
        drawn = []
        for face in parts.faces:
            draw(face.camera)
            drawn.append(np.isfinite(self._kernel.centres(count)[1]))
        return parts.centres(splats if isinstance(splats, Splats) else splats.splats, drawn)

    def fixed_view(self, camera: Camera, recorded: NDArray[np.bool_] | None = None) -> FixedView:
        parts = self._parts(camera)
        return WideView(self._kernel, parts, recorded) if parts.faces else self._kernel.fixed_view(camera, recorded)

    def optimiser(self, splats: Splats, *, beta1: float = 0.9, beta2: float = 0.999) -> Optimiser:
        return self._kernel.optimiser(splats, beta1=beta1, beta2=beta2)

    def view_gradients(self, count: int) -> ViewGradients:
        return self._kernel.view_gradients(count)

    def _parts(self, camera: Camera) -> _Parts:
        """Kept while the camera lives, and with them what its targets are in the faces."""
        known = self._cameras.get(id(camera))
        if known is None:
            forget = weakref.ref(camera, partial(self._forget, id(camera)))
            known = self._cameras[id(camera)] = forget, _Parts(camera)
        return known[1]

    def _forget(self, key: int, _: object) -> None:
        self._cameras.pop(key, None)


class WideView:
    """A `FixedView` of a very wide pinhole: those of its faces."""

    def __init__(self, kernel: TrainingKernel, parts: _Parts, recorded: NDArray[np.bool_] | None) -> None:
        self.camera, self._parts = parts.camera, parts
        everywhere = np.ones((self.camera.height, self.camera.width), np.bool_)
        needed = [face.needed(everywhere if recorded is None else recorded) for face in parts.faces]
        self._views = [kernel.fixed_view(f.camera, own) for f, own in zip(parts.faces, needed, strict=True)]
        self._met = np.ones(tile_count(self.camera.width, self.camera.height), np.uint8)
        self._scene: Splats | None = None
        self._planes: dict[str, FloatArray] = {}

    @property
    def rgb(self) -> FloatArray:
        return self._plane("rgb")

    @property
    def alpha(self) -> FloatArray:
        return self._plane("alpha")

    @property
    def depth(self) -> FloatArray:
        return self._plane("depth")

    @property
    def met(self) -> NDArray[np.uint8]:
        """All of them."""
        return self._met

    def set_scene(self, scene: Splats) -> None:
        self._scene = scene
        for view in self._views:
            view.set_scene(scene)

    def refresh(self) -> None:
        self._planes.clear()
        for view in self._views:
            view.refresh()

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        self._planes.clear()
        weights = [
            view.redraw(None if marks is None else face.needed(marks))
            for face, view in zip(self._parts.faces, self._views, strict=True)
        ]
        return np.asarray(np.sum(weights, axis=0), np.float32)

    def detach(self, rows: RowArray) -> None:
        for view in self._views:
            view.detach(rows)

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        self._planes.pop("rgb", None)
        if depth:
            self._planes.clear()
        for view in self._views:
            view.draw(moving, rows, depth=depth)

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        losses, factor = self._parts.losses(target, l1_weight, focus)
        return _sum_of(
            [
                _evaluated(view.loss, loss, factor * l1_scale, factor * ssim_scale)
                for view, loss in zip(self._views, losses, strict=True)
            ]
        )

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> Gradients:
        """Of the last loss alone."""
        if v_rgb is not None:
            raise ValueError("of a very wide picture only its loss has gradients")
        gradients = _Sum()
        for view in self._views:
            gradients.add(view.backward())
        assert gradients.total is not None
        return gradients.total

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        self._scene = scene
        for view in self._views:
            view.commit(scene, rows, renumbered)

    def squared_error(self, picture: FloatArray, counted: FloatArray | None = None) -> float:
        square = (np.clip(self.rgb, 0, 1) - picture) ** 2
        return float((square if counted is None else square * counted).sum(dtype=np.float64))

    def centres(self) -> FloatArray:
        assert self._scene is not None
        drawn = [np.isfinite(view.centres()[:, 0]) for view in self._views]
        return self._parts.centres(self._scene, drawn)[0]

    def _plane(self, name: str) -> FloatArray:
        if name not in self._planes:
            planes = [getattr(view, name) for view in self._views]
            self._planes[name] = self._parts.together(planes, depth=name == "depth")
        return self._planes[name]


class _Sum:
    """The sum of gradients, in the host's memory."""

    def __init__(self) -> None:
        self.total: SplatGradients | None = None

    def add(self, gradients: Gradients) -> None:
        more = gradients.host()
        if self.total is None:
            self.total = SplatGradients(*(getattr(more, field.name).copy() for field in fields(SplatGradients)))
            return
        for field in fields(SplatGradients):
            getattr(self.total, field.name)[...] += getattr(more, field.name)


def _evaluated(
    evaluate: Callable[..., LossValue], loss: _FaceLoss, l1_scale: float, ssim_scale: float
) -> tuple[float, float, LossValue]:
    value = evaluate(loss.target, l1_scale=l1_scale, ssim_scale=ssim_scale, l1_weight=loss.l1_weight, focus=loss.focus)
    return l1_scale, ssim_scale, value


def _sum_of(values: Sequence[tuple[float, float, LossValue]]) -> LossValue:
    """Of faces with the same scales; read when a number is asked for."""
    l1_scale, ssim_scale, _ = values[0]
    return LossValue(l1_scale, ssim_scale, lambda: np.sum([value.sums for _, _, value in values], axis=0))
