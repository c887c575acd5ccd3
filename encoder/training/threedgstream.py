"""The baseline: 3DGStream's recipe (Sun 2024), dense, on the same keyframe, views, rasteriser and cache as DecoGS.

Stage 1 trains the transformation cache over all Gaussians from its identity start, anew in every frame. The moved
Gaussians are what lasts. Stage 2 spawns Gaussians where the gradient was high and trains those alone; they show in
this frame only and are removed before the next one. Nothing is selected, nothing masked: every pixel and every
Gaussian takes part in every step, which is the cost and the flicker that DecoGS is measured against.

Numbers: the released configuration (SJoJoK/3DGStream: configs/cache/cache_F_4.json and
test/flame_steak_suite/cfg_args.json). Two things follow the released code and not the paper's text: gradients for
spawning are gathered in the last 20 steps of stage 1 only, and stage 2 takes away but adds nothing more (the code's
second round of spawning reads gradient sums that stage 2 never fills). Differences that remain: the cache's box is the
loop's, as for DecoGS, not 3DGStream's quantile box; frames pass through the lattice, so that the stream is an ordinary
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.rasterise.reference import rotation_matrices
from decogs.formats.splats import FloatArray, Splats, join_splats, take_splats

from ..change.masks import FrameMask
from ..input.ingest import View
from ..rasterise import SplatGradients, TrainingKernel, gradients_like
from ..settings.frame import FrameSettings
from ..settings.threedgstream import BaselineSettings
from ..transformation_cache import TransformationCache
from .delta import TrainedFrame
from .densification import ViewGradients, opacities_of
from .losses import PhotometricLoss, require_finite, whole_picture_loss
from .optimiser import ATTRIBUTES, SplatOptimiser
from .schedule import WHOLE, Effort
from .view_order import view_order


class BaselineTrainer:
    """Trains later frames of one stream as 3DGStream does.

    ``population``: Gaussians of the keyframe; rows of a scene beyond them were spawned for the frame before.
    ``extent`` is the rig's, the box bounds what the cache may move and where Gaussians may spawn.
    """

    def __init__(
        self,
        kernel: TrainingKernel,
        views: Sequence[View],
        settings: BaselineSettings,
        *,
        population: int,
        extent: float,
        box: tuple[NDArray[np.float64], NDArray[np.float64]],
        seed: int,
        threads: int = 1,
    ) -> None:
        self._kernel, self._views, self._settings = kernel, views, settings
        self._population, self._extent, self._box = population, extent, box
        self._seed = seed
        self._cache = TransformationCache(*box, settings.cache, seed, threads=threads)

    def train(
        self,
        scene: Splats,
        selected: NDArray[np.bool_],
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        motion: FloatArray,
        *,
        frame: int,
        settings: FrameSettings | None = None,
        effort: Effort = WHOLE,
    ) -> TrainedFrame:
        """Trains all Gaussians of ``scene`` on one frame's pictures (3, H, W).

        The call is `FrameTrainer.train`'s; ``selected``, ``masks``, ``motion`` and ``settings`` have no part in this
        method, nor has anything of ``effort`` that ends training early.
        """
        self._on_loss = effort.on_loss
        self._random = np.random.default_rng((self._seed, frame))
        self._order = view_order(len(self._views), self._random)
        losses = [
            whole_picture_loss(picture, view.valid, self._settings.dissimilarity)
            for picture, view in zip(pictures, self._views, strict=True)
        ]
        kept = np.arange(self._population)
        lasting = take_splats(scene, kept)
        gradients = self._stage1(lasting, losses)
        spawned = self._stage2(lasting, self._spawned(lasting, gradients), losses)
        return TrainedFrame(kept, lasting, np.arange(self._population, len(scene)), spawned)

    def _stage1(self, scene: Splats, losses: Sequence[PhotometricLoss]) -> NDArray[np.float64]:
        """Moves ``scene`` by a freshly trained cache; returns the mean view gradients that spawning goes by."""
        settings, cache = self._settings, self._cache
        gathered, gradients = ViewGradients(len(scene)), gradients_like(scene)
        cache.restart()
        cache.place(scene.means, scene.quaternions)
        for step in range(settings.cache_iterations):
            scene.means[:], scene.quaternions[:] = cache.moved()
            camera = self._views[self._descend(scene, losses, gradients, ("cache", step))].pinhole
            if step >= settings.cache_iterations - settings.spawn_window:
                gathered.add(gradients.view, camera.width, camera.height)
            cache.backward(gradients.means, gradients.quaternions)
            cache.step()
        scene.means[:], scene.quaternions[:] = cache.moved()
        return gathered.mean()

    def _spawned(self, scene: Splats, gradients: NDArray[np.float64]) -> Splats:
        """One new Gaussian beside every one in the box whose view gradient reaches the threshold."""
        settings = self._settings
        low, high = self._box
        inside = ((scene.means >= low) & (scene.means <= high)).all(axis=1)
        parents = take_splats(scene, np.flatnonzero(inside & (gradients >= settings.spawn_gradient)))
        scales = np.exp(parents.log_scales.astype(np.float64))
        rotations = rotation_matrices(np, parents.quaternions.astype(np.float64))
        drawn = settings.spawn_spread * scales * self._random.normal(size=scales.shape)
        upright = np.zeros_like(parents.quaternions)
        upright[:, 0] = 1
        logit = np.log(settings.spawn_opacity / (1 - settings.spawn_opacity))
        return Splats(
            (parents.means + np.einsum("nij,nj->ni", rotations, drawn)).astype(np.float32),
            parents.log_scales + np.float32(np.log(settings.spawn_growth)),
            upright,
            np.full(len(parents), logit, np.float32),
            parents.sh,
        )

    def _stage2(self, lasting: Splats, spawned: Splats, losses: Sequence[PhotometricLoss]) -> Splats:
        """Trains the spawned Gaussians alone, in the whole scene, and takes away those that come to nothing."""
        settings = self._settings
        rates = replace(settings.rates, means=settings.rates.means * self._extent)
        optimiser = SplatOptimiser(spawned, self._kernel)
        scene = join_splats(lasting, spawned)
        gradients = gradients_like(scene)
        for step in range(1, settings.spawn_iterations + 1):
            if not len(optimiser.splats):
                break
            self._descend(scene, losses, gradients, ("joint", step - 1))
            optimiser.step(_rows_from(gradients, self._population), rates)
            if step % settings.prune_every == 0:
                optimiser.keep(self._worth_keeping(optimiser.splats))
                scene = join_splats(lasting, optimiser.splats)
                gradients = gradients_like(scene)
            else:
                for name in ATTRIBUTES:
                    getattr(scene, name)[self._population :] = getattr(optimiser.splats, name)
        return take_splats(optimiser.splats, self._worth_keeping(optimiser.splats))

    def _worth_keeping(self, spawned: Splats) -> NDArray[np.bool_]:
        small = spawned.log_scales.max(axis=1, initial=-np.inf) <= np.log(self._settings.prune_size * self._extent)
        return np.asarray(small & (opacities_of(spawned) >= self._settings.prune_opacity))

    def _descend(
        self, scene: Splats, losses: Sequence[PhotometricLoss], out: SplatGradients, place: tuple[str, int]
    ) -> int:
        """Puts the gradients of the next view's loss into ``out``; returns which view; ``place`` is stage and step."""
        index = next(self._order)
        self._kernel.forward(scene, self._views[index].pinhole)
        value = losses[index].evaluate(self._kernel)
        require_finite(value, self._views[index].camera)
        if self._on_loss is not None:
            self._on_loss(*place, value.total)
        self._kernel.backward(scene, out=out)
        return index


def _rows_from(gradients: SplatGradients, first: int) -> SplatGradients:
    return SplatGradients(
        gradients.means[first:],
        gradients.log_scales[first:],
        gradients.quaternions[first:],
        gradients.opacity_logits[first:],
        gradients.sh[first:],
        gradients.view[first:],
    )
