"""The default method: the selected Gaussians follow the pictures, everything else stays.

They start from where the views' optical flow says they are, and train for a number of steps that goes with what the
frame then misses. After a quarter of the steps emerging objects get Gaussians; after half of them densification
follows, and right after it changes that hardly show are reverted. On a stage, displacements are smoothed at both
times. Gradients and Adam's moments exist for the selected Gaussians only. Equations: docs/METHOD.md, "Focus-aware
loss" to "Optimiser-state reset".
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..backends import Gradients
from ..training.emergence import add_emerging_in_time, add_undrawn
from ..training.frame_training import FrameTraining, LossOfView, Step, frame_training
from ..training.losses import focus_loss
from ..training.method import FrameInput, TrainedFrame, TrainingContext
from ..training.relighting import relight
from ..training.schedule import (
    MAX_STRETCH,
    Pace,
    StepSchedule,
    brighter_iteration_factor,
    iteration_factor,
    rates_at,
    seconds_at_least,
)
from ..training.selective_densification import densify
from ..training.significance import revert_insignificant
from ..training.warm_start import followed, shared_displacements
from ..training.working_set import WorkingSet

_LIGHT_ONLY_FACTOR = 4.0
"""Of the significance threshold, for places, sizes and turns of what light alone changes in a frame in which others
move: they keep to colour and opacity. Without it `stage` takes 7 % more bytes at the same quality."""

_SMOOTHED_AT, _SMOOTHING_NEIGHBOURS = (0.25, 0.5), 16
"""Shares of the steps after which displacements are smoothed over so many neighbours, where free space is known: on a
stage, Gaussians are dense on the performers. Without it `grey` loses .27 dB where things move and takes a fifth more
bytes. Elsewhere it costs: `panoptic_basketball`, where sixteen neighbours span two legs, -.8 dB."""

_MAX_PROBE_VIEWS = 4
"""Views whose error is measured when time is short: each is rendered twice, which takes as long as a step."""


class DecogsTrainer:
    """Trains the later frames of one stream. Between frames it keeps nothing."""

    def __init__(self, context: TrainingContext, *, loss: LossOfView = focus_loss) -> None:
        self.context, self._loss = context, loss

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains the selected Gaussians; diverged training changes nothing. A deadline or a target ends it early."""
        return self.train_set(frame, WorkingSet(frame, self.context.kernel))

    def train_set(self, frame: FrameInput, work: WorkingSet) -> TrainedFrame:
        """The same with a ``work`` that exists, whose optimiser may remember."""
        began = time.perf_counter()
        training = frame_training(self.context, frame, self._loss)
        probes = _probes(training)
        before = training.squared_error(probes)
        work.optimiser.put(means=followed(training, work))
        brighter = frame.relit and relight(training, work)
        factor = _iteration_factor(training, work, probes, brighter=brighter)
        schedule = StepSchedule(frame.settings.joint_iterations, frame.stopping.deadline, factor=factor)
        growth = _Growth(training, work)
        _train(training, work, schedule, growth)
        work.remove(np.flatnonzero(training.is_free(work.values.means)))
        trained = training.outcome(work, work.optimiser, before, probes)
        if frame.stopping.deadline is not None:
            step, _ = schedule.steps_seconds
            least = seconds_at_least(time.perf_counter() - began - growth.searching, schedule)
            trained = replace(trained, pace=Pace(step, least, growth.search))
        return trained if trained.rejected else replace(trained, truncated=schedule.is_truncated)


def _probes(training: FrameTraining) -> Sequence[int]:
    """A sample of the used views for measuring errors: every third, fewer when time is short."""
    deadline, every = training.frame.stopping.deadline, 3
    if deadline is not None:
        seconds = training.frame.pace.step * training.settings.joint_iterations
        if seconds > deadline - time.perf_counter():
            every = max(every, -(-len(training.used) // _MAX_PROBE_VIEWS))
    return training.used[::every]


def _smooth_displacements(work: WorkingSet) -> None:
    """Replaces the displacements so far by the medians of their neighbourhoods; new Gaussians stay."""
    old = np.flatnonzero(work.old)
    before, now = work.before().means[old], work.values.means[old]
    work.optimiser.put(old, means=before + shared_displacements(before, now - before, _SMOOTHING_NEIGHBOURS))


def _iteration_factor(
    training: FrameTraining, work: WorkingSet, probes: Sequence[int], *, brighter: bool = False
) -> float:
    """Factor of this frame's iterations; ``brighter``: its light is, by more than steps follow."""
    settings = training.settings
    if not settings.adaptive_iterations.usual_miss:
        return 1.0
    if brighter and training.frame.stopping.deadline is None:
        return brighter_iteration_factor(settings.joint_iterations)
    training.draw(probes, work, work.optimiser)
    errors, on_stage = training.errors(probes), training.frame.stage is not None
    return iteration_factor(settings.adaptive_iterations, settings.joint_iterations, errors, on_stage=on_stage)


def _train(training: FrameTraining, work: WorkingSet, schedule: StepSchedule, growth: _Growth) -> None:
    """Trains the Gaussians' values to the end of the schedule, or until the target quality is reached."""
    end = _End(training, work)
    smoothed_at = () if training.frame.stage is None else _SMOOTHED_AT
    for step in training.steps("joint"):
        if schedule.is_over:
            break
        if any(schedule.reaches(round(at * training.settings.joint_iterations)) for at in smoothed_at):
            _smooth_displacements(work)
        growth.before(schedule)
        gradients = training.gradients(step, work, work.optimiser)
        growth.after(schedule, gradients, step.view)
        if end.is_reached(schedule, step):
            break
        rates = rates_at(training.settings, training.context.extent, schedule)
        work.optimiser.step(gradients, rates, max_stretch=MAX_STRETCH)
        schedule.step()


class _Growth:
    """What joins the scene in a frame: emerging objects at a quarter of the schedule, clones and halves at half of it.

    ``searching``: seconds of the search for emerging objects, in a frame with a deadline. ``search``: the time for it.
    """

    def __init__(self, training: FrameTraining, work: WorkingSet) -> None:
        self._training, self._work, self.search = training, work, training.frame.pace.search
        iterations = training.settings.joint_iterations
        self._from, self._at = iterations // 4, iterations // 2
        self._gathered = training.context.kernel.view_gradients(len(work.rows))
        self.searching = 0.0

    def before(self, schedule: StepSchedule) -> None:
        """Adds what is due before a step."""
        training, work = self._training, self._work
        if schedule.reaches(self._at):
            densify(training, work, work.values, self._gathered)
        if schedule.reaches(self._from):
            self.searching, self.search = add_emerging_in_time(training, work, schedule, self.search)
            if training.frame.stopping.deadline is None:
                add_undrawn(training, work)
            self._gathered = training.context.kernel.view_gradients(len(work.rows))

    def after(self, schedule: StepSchedule, gradients: Gradients, view: int) -> None:
        """Gathers a step's gradients in the second quarter."""
        if self._from <= schedule.position < self._at:
            self._training.gather(self._gathered, gradients, view)


class _End:
    """Reverts a frame's insignificant changes once, and then ends its training at the target quality."""

    def __init__(self, training: FrameTraining, work: WorkingSet) -> None:
        self._training, self._work = training, work
        settings = training.settings
        # After densification: a reverted value stays as it is until rows come or go.
        self._revert_at = settings.joint_iterations // 2 + 1
        self._has_reverted = settings.significance.threshold == 0
        self._target = training.target_watch()

    def is_reached(self, schedule: StepSchedule, step: Step) -> bool:
        """Whether training ends with this drawn step; a target reached too early skips to the revert."""
        if schedule.reaches(self._revert_at) and not self._has_reverted:
            self._has_reverted = True
            _revert_insignificant(self._training, self._work)
            if self._target is not None:
                self._target.restart()
        elif self._target is not None and self._target.update(step.view, self._drawn(step)):
            if self._has_reverted:
                return True
            schedule.skip_to(self._revert_at)
        return False

    def _drawn(self, step: Step) -> np.ndarray:
        return self._training.context.static_views[step.view].rgb


def _revert_insignificant(training: FrameTraining, work: WorkingSet) -> None:
    """Reverts what hardly shows; geometry sooner where light alone changes the pictures."""
    training.seen.check()
    settings, old, light_only, factor = training.settings.significance, work.old, training.frame.light_only, None
    if light_only is not None:
        factor = np.ones(len(work.rows), np.float32)
        factor[old] = np.where(light_only[work.rows[old]], _LIGHT_ONLY_FACTOR, 1)
    threshold = settings.threshold * training.picture_weight
    revert_insignificant(work.optimiser, work.before(), old, threshold, factor)
