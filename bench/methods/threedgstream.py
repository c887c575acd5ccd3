"""The baseline: 3DGStream's recipe (Sun 2024), dense, on the same keyframe, views, rasteriser and cache as DecoGS.

Stage 1 trains the transformation cache over all Gaussians from its identity start, anew in every frame. The moved
Gaussians persist. Stage 2 spawns Gaussians where the gradient was high and trains them alone; they are visible in this
frame only and are removed before the next one. There is no selection and no mask: every pixel and every Gaussian takes
part in every step. Its cost and flicker are the reference for DecoGS.

Numbers: the released configuration (SJoJoK/3DGStream: configs/cache/cache_F_4.json and
test/flame_steak_suite/cfg_args.json). Two things follow the released code and not the paper's text: gradients for
spawning are gathered in the last 20 steps of stage 1 only, and stage 2 prunes and adds nothing more (the code's
second round of spawning reads gradient sums that stage 2 never fills). Differences that remain: the cache's box is the
loop's, as for DecoGS, not 3DGStream's quantile box; frames pass through the lattice, so that the stream is an ordinary
one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.encoder.backends import ATTRIBUTES, SplatGradients, gradients_like
from decogs.encoder.methods.transformation_cache import RELEASED_CACHE, CacheConfig, TransformationCache
from decogs.encoder.settings.optimiser import LearningRates
from decogs.encoder.training.losses import PhotometricLoss, require_finite, whole_picture_loss
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame, TrainingContext
from decogs.encoder.training.view_order import view_order
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.splats import Splats, join_splats, logit, sigmoid, take_splats

DISSIMILARITY = 0.2
"""Lambda of 3DGS's loss."""
RATES = LearningRates(
    means=1.6e-4, log_scales=5e-3, quaternions=1e-3, opacity_logits=5e-2, sh_dc=2.5e-3, sh_rest=2.5e-3 / 20
).scaled(15)
"""Of stage 2: 3DGS's own (Kerbl 2023) times 15, ``means`` in units of the rig's extent."""
_SPAWN_WINDOW_STEPS = 20
"""Last steps of stage 1 over which view gradients are gathered."""
_SPAWN_SPREAD_SIGMAS = 2.0
"""Standard deviation of a spawned Gaussian's place about its parent's, in the parent's own sigmas."""
_SPAWN_OPACITY, _SPAWN_GROWTH = 0.1, 1.25
"""Of a spawned Gaussian: opacity, and size in units of its parent's."""


@dataclass(frozen=True)
class BaselineConfig:
    """The other numbers of the recipe; steps are of one view each."""

    cache: CacheConfig = RELEASED_CACHE
    cache_iterations: int = 150  # steps of stage 1
    spawn_iterations: int = 100  # steps of stage 2
    spawn_gradient: float = 1.5e-4  # mean view gradient from which a Gaussian spawns another
    prune_every: int = 20  # steps of stage 2
    prune_opacity: float = 0.01  # below it a spawned Gaussian goes
    prune_size: float = 0.1  # sigma above which it goes, in units of the rig's extent


_RELEASED = BaselineConfig()


class BaselineTrainer:
    """Trains later frames of one stream as 3DGStream does.

    Rows of a scene beyond the keyframe's were spawned for the frame before. ``context.box`` also bounds where Gaussians
    may spawn. The schedule is fixed.
    """

    def __init__(self, context: TrainingContext, config: BaselineConfig = _RELEASED) -> None:
        self._kernel, self._views, self._config = context.kernel, context.views, config
        self._population, self._extent, self._box = context.population, context.extent, context.box
        self._seed = context.seed
        self._cache = TransformationCache(
            *self._box, config.cache, self._seed, extent=self._extent, threads=context.threads
        )

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains all Gaussians; S_t, masks, motion, the frame's settings and an early end have no part in it."""
        scene, pictures = frame.scene, frame.pictures
        self._on_loss = frame.stopping.on_loss
        self._random = np.random.default_rng((self._seed, frame.index))
        shown = [view for view in range(len(self._views)) if view not in frame.lost]
        self._order = (shown[slot] for slot in view_order(len(shown), self._random))
        losses = [
            whole_picture_loss(picture, view.valid, DISSIMILARITY)
            for picture, view in zip(pictures, self._views, strict=True)
        ]
        kept = np.arange(self._population)
        lasting = take_splats(scene, kept)
        gradients = self._stage1(lasting, losses)
        spawned = self._stage2(lasting, self._spawn(lasting, gradients), losses)
        return TrainedFrame(kept, lasting, np.arange(self._population, len(scene)), spawned)

    def _stage1(self, scene: Splats, losses: Sequence[PhotometricLoss]) -> NDArray[np.float64]:
        """Moves ``scene`` by a freshly trained cache; returns the mean view gradients that spawning goes by."""
        config, cache = self._config, self._cache
        gathered, gradients = self._kernel.view_gradients(len(scene)), gradients_like(scene)
        cache.restart()
        cache.place(scene.means, scene.quaternions)
        for step in range(config.cache_iterations):
            scene.means[:], scene.quaternions[:] = cache.move()
            camera = self._views[self._next_gradients(scene, losses, gradients, ("cache", step))].pinhole
            if step >= config.cache_iterations - _SPAWN_WINDOW_STEPS:
                gathered.add(gradients, camera)
            cache.backward(gradients.means, gradients.quaternions)
            cache.step()
        scene.means[:], scene.quaternions[:] = cache.move()
        return gathered.mean()

    def _spawn(self, scene: Splats, gradients: NDArray[np.float64]) -> Splats:
        """One new Gaussian beside every one in the box whose view gradient reaches the threshold."""
        config = self._config
        low, high = self._box
        inside = ((scene.means >= low) & (scene.means <= high)).all(axis=1)
        parents = take_splats(scene, np.flatnonzero(inside & (gradients >= config.spawn_gradient)))
        scales = np.exp(parents.log_scales.astype(np.float64))
        rotations = rotation_matrices(parents.quaternions.astype(np.float64))
        drawn = _SPAWN_SPREAD_SIGMAS * scales * self._random.normal(size=scales.shape)
        upright = np.zeros_like(parents.quaternions)
        upright[:, 0] = 1
        return Splats(
            (parents.means + np.einsum("nij,nj->ni", rotations, drawn)).astype(np.float32),
            parents.log_scales + np.float32(np.log(_SPAWN_GROWTH)),
            upright,
            np.full(len(parents), logit(_SPAWN_OPACITY), np.float32),
            parents.sh,
        )

    def _stage2(self, lasting: Splats, spawned: Splats, losses: Sequence[PhotometricLoss]) -> Splats:
        """Trains the spawned Gaussians alone, in the whole scene, and prunes transparent and large ones."""
        config = self._config
        rates = replace(RATES, means=RATES.means * self._extent)
        optimiser = self._kernel.optimiser(spawned)
        scene = join_splats(lasting, spawned)
        gradients = gradients_like(scene)
        for step in range(1, config.spawn_iterations + 1):
            if not len(optimiser.splats):
                break
            self._next_gradients(scene, losses, gradients, ("joint", step - 1))
            optimiser.step(_rows_from(gradients, self._population), rates)
            if step % config.prune_every == 0:
                optimiser.keep(self._is_lasting(optimiser.splats))
                scene = join_splats(lasting, optimiser.splats)
                gradients = gradients_like(scene)
            else:
                for name in ATTRIBUTES:
                    getattr(scene, name)[self._population :] = getattr(optimiser.splats, name)
        return take_splats(optimiser.splats, self._is_lasting(optimiser.splats))

    def _is_lasting(self, spawned: Splats) -> NDArray[np.bool_]:
        small = spawned.log_scales.max(axis=1, initial=-np.inf) <= np.log(self._config.prune_size * self._extent)
        return np.asarray(small & (sigmoid(spawned.opacity_logits) >= self._config.prune_opacity))

    def _next_gradients(
        self, scene: Splats, losses: Sequence[PhotometricLoss], out: SplatGradients, step: tuple[str, int]
    ) -> int:
        """Puts the gradients of the next view's loss into ``out``; returns which view; ``step`` is stage and step."""
        index = next(self._order)
        self._kernel.forward(scene, self._views[index].pinhole)
        value = losses[index].evaluate(self._kernel)
        require_finite(value, self._views[index].camera)
        if self._on_loss is not None:
            self._on_loss(*step, value.total)
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


BASELINE = FrameMethod(BaselineTrainer, dense=True)
