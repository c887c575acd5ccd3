"""One later frame: the selected Gaussians follow the pictures, everything else stays (method.md, steps 3 to 6).

Stage 1 trains the transformation cache alone. Then Gaussians are added and taken away inside the region of
interest. Stage 2 trains the selected Gaussians' own values together with the cache. Values of other Gaussians are
never written: gradients are computed for the selected only, and Adam's moments exist for the selected only, so that
the paper's gradient gate and its reset of stale moments hold by construction.

Beyond the paper: ``warm_start`` lets a Gaussian begin where its last displacement would take it. Without a cache
(``cache`` None) stage 1 is left out and stage 2 moves the Gaussians directly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from decogs.formats.errors import TrainingError
from decogs.formats.splats import FloatArray, Splats, join_splats, take_splats

from .densification import ViewGradients, grow, opacities_of, strongest
from .ingest import View
from .losses import FocusWeights, PhotometricLoss, focus_loss
from .masks import FrameMask, MaskSettings
from .optimiser import LearningRates, SplatOptimiser
from .rasterise import SplatGradients, TrainingKernel
from .selection import SelectionSettings
from .transformation_cache import CacheSettings, TransformationCache


@dataclass(frozen=True)
class FrameSettings:
    """How a later frame is trained; the defaults are the paper's where it gives a number.

    ``cache_iterations`` and ``joint_iterations``: stage 1 and stage 2; more is slower and follows faster motion.
    ``carry_cache``: keep the cache's weights from frame to frame instead of restarting it. ``warm_start``: share of
    the last displacement to begin with, 0 to 1. ``grow_gradient``: the paper's tau_d; lower adds more Gaussians.
    ``grow_share``: most Gaussians a frame may add, as a share of the selected. ``rates``: stage 2, ``means`` in
    units of the rig's extent.
    """

    masks: MaskSettings = field(default_factory=MaskSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    cache: CacheSettings | None = field(default_factory=CacheSettings)
    carry_cache: bool = False
    cache_iterations: int = 150
    joint_iterations: int = 100
    warm_start: float = 0.0
    grow_gradient: float = 1e-4
    grow_share: float = 0.05
    prune_opacity: float = 0.01
    focus: FocusWeights = field(default_factory=FocusWeights)
    rates: LearningRates = field(default_factory=lambda: LearningRates(6.4e-4, 1e-2, 4e-3, 0.05, 1e-2, 5e-4))
    late_decay: float = 0.3


@dataclass(frozen=True)
class TrainedFrame:
    """What a frame changed: new values (M rows) for the rows ``kept`` of the scene, rows ``removed``, Gaussians ``added``."""

    kept: NDArray[np.int64]
    values: Splats
    removed: NDArray[np.int64]
    added: Splats


class FrameTrainer:
    """Trains later frames of one stream; ``extent`` is the rig's, the box bounds what the cache may move."""

    def __init__(
        self,
        kernel: TrainingKernel,
        views: Sequence[View],
        settings: FrameSettings,
        *,
        extent: float,
        box: tuple[NDArray[np.float64], NDArray[np.float64]],
        seed: int,
        threads: int = 1,
    ) -> None:
        self._kernel, self._views, self._settings = kernel, views, settings
        self._random = np.random.default_rng(seed)
        self._extent = extent
        self._cache: TransformationCache | None = None
        if settings.cache is not None and settings.cache_iterations + settings.joint_iterations > 0:
            self._cache = TransformationCache(*box, settings.cache, seed, threads=threads)

    def train(
        self,
        scene: Splats,
        selected: NDArray[np.bool_],
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        motion: FloatArray,
    ) -> TrainedFrame:
        """Trains the ``selected`` Gaussians of ``scene`` on one frame's pictures (3, H, W).

        ``motion`` (N, 3) is every Gaussian's last displacement, for the warm start.
        """
        losses = [
            focus_loss(picture, mask.dilated, view.valid, self._settings.focus)
            for picture, mask, view in zip(pictures, masks, self._views, strict=True)
        ]
        work = _Working(scene, np.flatnonzero(selected))
        work.base.means[:] += np.float32(self._settings.warm_start) * motion[work.rows]
        if self._cache is not None:
            if not self._settings.carry_cache:
                self._cache.restart()
            self._cache.place(work.base.means, work.base.quaternions)
        view_gradients = self._stage1(work, losses)
        removed = self._densify(work, view_gradients, masks)
        self._stage2(work, losses)
        return work.result(removed)

    def _stage1(self, work: _Working, losses: Sequence[PhotometricLoss]) -> ViewGradients:
        """The cache alone; the last third gathers the gradients that densification goes by."""
        gathered = ViewGradients(len(work.scene))
        iterations = self._settings.cache_iterations if self._cache is not None else 0
        for step, index in enumerate(self._view_order(iterations)):
            work.show(*self._moved(work), work.base)
            gradients = self._gradients(work, losses, index)
            assert self._cache is not None
            self._cache.backward(gradients.means[work.rows], gradients.quaternions[work.rows])
            self._cache.step()
            if 3 * step >= 2 * iterations:
                gathered.add(gradients.view, self._views[index].pinhole.width, self._views[index].pinhole.height)
        work.show(*self._moved(work), work.base)
        if not iterations:
            for index, view in enumerate(self._views):
                gathered.add(self._gradients(work, losses, index).view, view.pinhole.width, view.pinhole.height)
        return gathered

    def _stage2(self, work: _Working, losses: Sequence[PhotometricLoss]) -> None:
        settings = self._settings
        rates = replace(settings.rates, means=settings.rates.means * self._extent)
        optimiser = SplatOptimiser(work.base, self._kernel)
        for step, index in enumerate(self._view_order(settings.joint_iterations)):
            if self._cache is not None:
                self._cache.rebase(optimiser.splats.means, optimiser.splats.quaternions)
            work.base = optimiser.splats
            work.show(*self._moved(work), work.base)
            gradients = _gradient_rows(self._gradients(work, losses, index), work.rows)
            if self._cache is not None:
                means, quaternions = self._cache.backward(gradients.means, gradients.quaternions)
                gradients = replace(gradients, means=means, quaternions=quaternions)
                self._cache.step()
            late = settings.late_decay ** max(0.0, 2 * step / settings.joint_iterations - 1)
            optimiser.step(gradients, rates.scaled(late))
        work.base = optimiser.splats
        if self._cache is not None:
            self._cache.rebase(work.base.means, work.base.quaternions)
        work.show(*self._moved(work), work.base)

    def _moved(self, work: _Working) -> tuple[FloatArray, FloatArray]:
        if self._cache is None:
            return work.base.means, work.base.quaternions
        return self._cache.moved()

    def _gradients(self, work: _Working, losses: Sequence[PhotometricLoss], index: int) -> SplatGradients:
        picture = self._kernel.forward(work.scene, self._views[index].pinhole)
        value, cotangent = losses[index].evaluate(self._kernel, picture.rgb)
        if not np.isfinite(value.total):
            raise TrainingError(
                f"the loss of camera {self._views[index].camera.name} is {value.total}; lower the rates"
            )
        return self._kernel.backward(work.scene, cotangent, selected=work.selected)

    def _view_order(self, steps: int) -> list[int]:
        """Views at random, each once before any comes again."""
        order: list[int] = []
        while len(order) < steps:
            order += [int(i) for i in self._random.permutation(len(self._views))]
        return order[:steps]

    def _densify(self, work: _Working, view_gradients: ViewGradients, masks: Sequence[FrameMask]) -> NDArray[np.int64]:
        """Adds Gaussians to ``work`` where the gradient asks for them; returns the scene rows to remove."""
        settings = self._settings
        gradients = view_gradients.mean()[work.rows]
        faint = opacities_of(work.base) < settings.prune_opacity
        room = int(settings.grow_share * len(work.rows))
        parents = strongest(gradients, ~faint, settings.grow_gradient, room)
        if len(parents):
            growth = grow(work.base, parents, 0.01 * self._extent, self._random)
            shift = work.scene.means[work.rows[parents]] - work.base.means[parents]
            stray = ~self._inside_focus(growth.children.means + shift, masks)
            growth.children.means[stray] = work.base.means[parents[stray]]
            work.base.means[parents] = growth.parent_means
            work.base.log_scales[parents] = growth.parent_log_scales
            work.append(growth.children)
        removed = work.rows[: len(faint)][faint]
        work.remove(removed)
        if self._cache is not None and (len(parents) or len(removed)):
            self._cache.place(work.base.means, work.base.quaternions, same_frame=True)
        return removed

    def _inside_focus(self, means: FloatArray, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
        """Points (P, 3) that project into the region of interest of at least one view."""
        inside = np.zeros(len(means), bool)
        for view, mask in zip(self._views, masks, strict=True):
            camera = view.pinhole
            position = means.astype(np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
            with np.errstate(divide="ignore", invalid="ignore"):
                u = camera.fx * position[:, 0] / position[:, 2] + camera.cx
                v = camera.fy * position[:, 1] / position[:, 2] + camera.cy
            seen = (position[:, 2] > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
            rows = np.flatnonzero(seen)
            inside[rows] |= mask.dilated[v[rows].astype(np.int64), u[rows].astype(np.int64)]
        return inside


class _Working:
    """A frame in the making: the whole scene as rendered, and the base values of the rows under training.

    ``scene`` holds the previous frame's N Gaussians, then the added ones; ``rows`` are the scene's rows under
    training and ``base`` their values before the cache moves them. Removed rows stay in ``scene``, invisible.
    """

    def __init__(self, scene: Splats, rows: NDArray[np.int64]) -> None:
        self.population = len(scene)
        self.scene = take_splats(scene, np.arange(len(scene)))
        self.rows = rows
        self.base = take_splats(scene, rows)
        self.selected = np.zeros(len(scene), bool)
        self.selected[rows] = True

    def show(self, means: FloatArray, quaternions: FloatArray, values: Splats) -> None:
        """Puts the rows under training into the scene, moved."""
        self.scene.means[self.rows] = means
        self.scene.quaternions[self.rows] = quaternions
        self.scene.log_scales[self.rows] = values.log_scales
        self.scene.opacity_logits[self.rows] = values.opacity_logits
        self.scene.sh[self.rows] = values.sh

    def append(self, children: Splats) -> None:
        """Every per-Gaussian buffer follows the new count (method.md: re-synchronisation)."""
        first = len(self.scene)
        self.scene = join_splats(self.scene, children)
        self.base = join_splats(self.base, children)
        self.rows = np.concatenate([self.rows, np.arange(first, len(self.scene))])
        self.selected = np.concatenate([self.selected, np.ones(len(children), bool)])

    def remove(self, removed: NDArray[np.int64]) -> None:
        """Takes rows out of training and out of the picture."""
        if not len(removed):
            return
        stays = ~np.isin(self.rows, removed)
        self.rows, self.base = self.rows[stays], take_splats(self.base, stays)
        self.selected[removed] = False
        self.scene.opacity_logits[removed] = -80.0

    def result(self, removed: NDArray[np.int64]) -> TrainedFrame:
        """Bakes the cache's motion in (method.md, step 7)."""
        old = self.rows < self.population
        return TrainedFrame(
            self.rows[old],
            take_splats(self.scene, self.rows[old]),
            removed,
            take_splats(self.scene, self.rows[~old]),
        )


def _gradient_rows(gradients: SplatGradients, rows: NDArray[np.int64]) -> SplatGradients:
    return SplatGradients(
        gradients.means[rows],
        gradients.log_scales[rows],
        gradients.quaternions[rows],
        gradients.opacity_logits[rows],
        gradients.sh[rows],
        gradients.view[rows],
    )
