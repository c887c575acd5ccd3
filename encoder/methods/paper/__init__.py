"""The paper's method: DecoGS (arXiv 2609.17230), step by step. ``--preset paper`` has its numbers.

| step | equation (docs/METHOD.md) | code |
|---|---|---|
| difference mask, dilation | M = [max over RGB of abs(I_t - I_t-1) > tau], max-pool with radius r | `change.masks` |
| selection | S_t: the centre lies in the mask in kappa of the views that see it | `change.selection.by_centres` |
| stage 1 | mu' = mu + dmu, q' = q (x) dq, of S_t alone | `stages.train_cache` |
| densification | mean view gradient >= tau_d, inside the focus | `training.selective_densification` |
| stage 2 | the values of S_t, together with the cache | `stages.train_jointly` |
| loss | (1 - lambda) (beta1 L1 + beta2 L1_focus) + lambda (1 - SSIM_focus) | `training.losses.focus_loss` |
| gate, reset | no gradient and no moments outside S_t | `training.working_set`, `backends.cpu.fixed_view` |
| commit | the cache's motion becomes the Gaussians' own | `WorkingSet.result` |

METHOD.md lists where the preset and the text differ.
"""

from __future__ import annotations

import time
from dataclasses import replace

from ...training.frame_training import LossOfView, frame_training
from ...training.losses import focus_loss
from ...training.method import FrameInput, TrainedFrame, TrainingContext
from ...training.relighting import relight
from ...training.schedule import StepSchedule, seconds_at_least
from ...training.selective_densification import densify
from ...training.working_set import WorkingSet
from ..decogs import DecogsTrainer
from ..transformation_cache import RELEASED_CACHE, CacheConfig, TransformationCache
from .stages import CACHE_ITERATIONS, move_by_cache, train_cache, train_jointly


class PaperTrainer:
    """Trains the later frames of one stream as the paper does. The cache starts as the identity in every frame."""

    def __init__(
        self,
        context: TrainingContext,
        *,
        loss: LossOfView = focus_loss,
        cache: CacheConfig = RELEASED_CACHE,
        cache_iterations: int = CACHE_ITERATIONS,
    ) -> None:
        self.context, self.cache_iterations, self._loss = context, cache_iterations, loss
        # Of frames that light alone changes: a cache would move what stands.
        self._still = DecogsTrainer(context, loss=loss)
        self._cache = TransformationCache(
            *context.box, cache, context.seed, extent=context.extent, threads=context.threads
        )

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains S_t; diverged training changes nothing. A deadline ends either stage early, a target stage 2."""
        return self.train_set(frame, WorkingSet(frame, self.context.kernel))

    def train_set(self, frame: FrameInput, work: WorkingSet) -> TrainedFrame:
        """The same with a ``work`` that exists, whose optimiser may remember."""
        if not frame.settings.rates.means:
            return self._still.train_set(frame, work)
        began, cache, settings = time.perf_counter(), self._cache, frame.settings
        training = frame_training(self.context, frame, self._loss)
        sample = training.used[::3]
        before = training.squared_error(sample)
        if frame.relit:
            relight(training, work)
        cache.restart()
        cache.place(work.values.means, work.values.quaternions)
        gathered = train_cache(training, work, cache, self.cache_iterations)
        if densify(training, work, move_by_cache(work, cache), gathered):
            cache.place(work.values.means, work.values.quaternions, same_frame=True)
        schedule = StepSchedule(settings.joint_iterations, frame.stopping.deadline)
        train_jointly(training, work, cache, schedule)
        trained = training.outcome(work, move_by_cache(work, cache), before, sample)
        if frame.stopping.deadline is not None:
            least = seconds_at_least(time.perf_counter() - began, schedule)
            trained = replace(trained, pace=replace(frame.pace, least=least))
        return trained if trained.rejected else replace(trained, truncated=schedule.is_truncated)
