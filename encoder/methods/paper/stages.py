"""The paper's two stages: the transformation cache alone, then the Gaussians' own values together with it."""

from __future__ import annotations

from dataclasses import replace

from decogs.formats.splats import Splats

from ...backends import SplatGradients, ViewGradients
from ...training.frame_training import FrameTraining
from ...training.schedule import StepSchedule, rates_at
from ...training.working_set import WorkingSet
from ..transformation_cache import TransformationCache

CACHE_ITERATIONS = 150
"""Steps of stage 1, as the paper has them; those of stage 2 are the settings' ``joint_iterations``."""


def move_by_cache(work: WorkingSet, cache: TransformationCache) -> Splats:
    """The Gaussians under training where the cache moves them: mu' = mu + dmu, q' = q (x) dq."""
    cache.rebase(work.values.means, work.values.quaternions)
    means, quaternions = cache.move()
    return replace(work.values, means=means, quaternions=quaternions)


def train_cache(
    training: FrameTraining, work: WorkingSet, cache: TransformationCache, iterations: int
) -> ViewGradients:
    """Stage 1: trains the cache alone; the gradients of its last third, for densification."""
    gathered = training.context.kernel.view_gradients(len(work.rows))
    deadline = training.frame.stopping.deadline_before(iterations, training.settings.joint_iterations)
    schedule = StepSchedule(iterations, deadline)
    for step in training.steps("cache"):
        if schedule.is_over:
            break
        gradients = training.gradients(step, work, move_by_cache(work, cache)).host()
        cache.backward(gradients.means, gradients.quaternions)
        cache.step()
        if 3 * schedule.position >= 2 * iterations:
            training.gather(gathered, gradients, step.view)
        schedule.step()
    return gathered


def train_jointly(
    training: FrameTraining, work: WorkingSet, cache: TransformationCache, schedule: StepSchedule
) -> None:
    """Stage 2: trains the Gaussians' own values together with the cache, to the schedule's end or a target quality."""
    target = training.target_watch()
    for step in training.steps("joint"):
        if schedule.is_over:
            break
        gradients = _through(cache, training.gradients(step, work, move_by_cache(work, cache)).host())
        if target is not None and target.update(step.view, training.context.static_views[step.view].rgb):
            break
        work.optimiser.step(gradients, rates_at(training.settings, training.context.extent, schedule))
        schedule.step()


def _through(cache: TransformationCache, gradients: SplatGradients) -> SplatGradients:
    """Steps the cache; the gradients of the values that it moves."""
    means, quaternions = cache.backward(gradients.means, gradients.quaternions)
    cache.step()
    return replace(gradients, means=means, quaternions=quaternions)
