"""The training of one frame: the changes of the selected Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.rig.stage.stage import Stage

from ..change.masks import usable_views
from ..coding.scene import Scene
from ..stopwatch import Stopwatch
from ..training.method import FrameInput, TrainedFrame
from ..training.schedule import UNKNOWN_PACE
from .context import Context
from .events import Kind, PendingFrame
from .plan import FramePlan, find_selected

_CATCH_UP_ROUNDS = 3
"""Trainings of a closed segment's first frame. `workbench`: 28.83 dB, of one round 28.01."""


def train_frame(context: Context, frame: PendingFrame, plan: FramePlan, watch: Stopwatch) -> tuple[Scene, TrainedFrame]:
    """The changes of a frame, and the scene that they are against.

    The first frame of a closed segment catches up with all that has happened since the stream's first one, in
    _CATCH_UP_ROUNDS, each with a search for new objects. A round that diverges is the last, and changes
    nothing.
    """
    if not frame.restarted:
        return frame.scene, _train(context, frame, plan, watch)
    plan, scene = replace(plan, light_only=None), frame.scene  # Every round selects again.
    trained = _train(context, frame, plan, watch)
    for _ in range(1, _CATCH_UP_ROUNDS):
        if trained.rejected:
            break
        before = scene
        with watch.stage("commit"):
            scene = before.with_changes(trained, plan.settings.significance)
            frame.memory.views.update(scene.splats, trained.kept, before.state.ids, scene.state.ids)
        again = replace(frame, scene=scene)
        plan = replace(plan, selected=find_selected(context, again, plan.masks, watch))
        trained = _train(context, again, plan, watch)
    # What an earlier round has changed stays: then the frame is not rejected.
    return scene, replace(trained, rejected=trained.rejected and scene is frame.scene)


def _train(context: Context, frame: PendingFrame, plan: FramePlan, watch: Stopwatch) -> TrainedFrame:
    scene, memory = frame.scene, frame.memory
    deadline = None if memory.time is None else memory.time.deadline(watch.seconds)
    given = FrameInput(
        frame.index,
        scene.splats,
        plan.selected,
        plan.light_only,
        frame.pictures,
        plan.masks,
        plan.settings,
        context.stopping(deadline),
        _stage(context, frame, plan),
        frame.recorded.lost_views(context.ingest.views).keys(),
        plan.relit,
        plan.relit or memory.masks.relit,
        UNKNOWN_PACE if memory.time is None else memory.time.pace,
    )
    with watch.stage("training"):
        if not context.method.dense:
            memory.views.of(scene.splats).detach(np.flatnonzero(given.selected))
        return memory.trainer.train(given)


def _stage(context: Context, frame: PendingFrame, plan: FramePlan) -> Stage | None:
    """The stage in this frame, if it is one whose empty space is known."""
    stage = frame.memory.stage
    if stage is None or frame.kind is not Kind.CHANGE:
        return None
    return stage.in_frame(context.ingest.views, frame.compensated, usable_views(plan.masks))
