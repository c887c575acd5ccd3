"""The training of one frame: the changes of the selected Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..change.masks import usable_views
from ..coding.scene import Scene
from ..stopwatch import Stopwatch
from ..training.method import FrameInput, FreeSpace, TrainedFrame
from ..training.warm_start import Motion
from .context import Context
from .events import Event, Kind, PendingFrame
from .plan import FramePlan, select_again


def train_frame(
    context: Context, event: Event, plan: FramePlan, frame: PendingFrame, watch: Stopwatch
) -> tuple[Scene, TrainedFrame]:
    """The changes of a frame, and the scene that they are against.

    The first frame of a closed segment catches up with all that has happened since the stream's first one, in
    ``settings.catch_up`` rounds, each with a search for new objects. A round that diverges is the last, and changes
    nothing.
    """
    if not frame.restarted:
        return event.scene, _train(context, event, plan, frame, watch)
    plan, scene = replace(plan, light_only=None), event.scene  # Every round selects again.
    trained = _train(context, event, plan, frame, watch)
    for _ in range(1, context.settings.catch_up):
        if trained.rejected:
            break
        before = scene
        with watch.stage("commit"):
            scene = before.with_changes(trained, plan.settings.significance)
            context.views.update(scene.splats, trained.kept, before.state.ids, scene.state.ids)
        with watch.stage("selection"):
            plan = replace(plan, selection=select_again(context, scene, event, plan.selection))
        at_rest = replace(event.memory, motion=Motion.at_rest(len(scene.state)))
        trained = _train(context, replace(event, scene=scene, memory=at_rest), plan, frame, watch)
    # What an earlier round has changed stays: then the frame is not rejected.
    return scene, replace(trained, rejected=trained.rejected and scene is event.scene)


def _train(context: Context, event: Event, plan: FramePlan, frame: PendingFrame, watch: Stopwatch) -> TrainedFrame:
    scene, memory = event.scene, event.memory
    deadline = None if memory.time is None else memory.time.deadline(watch.seconds)
    given = FrameInput(
        frame.recorded.index - scene.header.first_frame,
        scene.splats,
        plan.selection.selected,
        plan.light_only,
        frame.pictures,
        plan.selection.masks,
        memory.motion.predict(),
        plan.settings,
        context.stopping(deadline),
        _free_space(context, event, plan, frame),
        frame.recorded.lost_views(context.ingest.views).keys(),
        plan.relit,
        plan.relit or memory.masks.relit,
    )
    with watch.stage("training"):
        if not context.method.dense:
            context.views.of(scene.splats).detach(np.flatnonzero(given.selected))
        return memory.trainer.train(given)


def _free_space(context: Context, event: Event, plan: FramePlan, frame: PendingFrame) -> FreeSpace | None:
    """Where a stage is empty in this frame; None where that is not known."""
    stage = event.memory.stage
    if stage is None or event.kind is not Kind.CHANGE:
        return None
    return stage.in_frame(context.ingest.views, frame.compensated, usable_views(plan.selection.masks)).free
