"""The end of a frame: the views are updated to the new scene, and the next frame gets its memory."""

from __future__ import annotations

from dataclasses import replace

from decogs.codec.scene.state import same_values

from ..change.masks import MaskMemory
from ..coding.packets import Written
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation import CorrectionMemory
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from ..training.warm_start import Motion
from .context import Context
from .events import PendingFrame
from .memory import Memory
from .plan import FramePlan


def redraw(context: Context, frame: PendingFrame, scene: Scene, trained: TrainedFrame | None, watch: Stopwatch) -> None:
    """Draws the frame's new ``scene`` in the views; ``trained``: what training changed, None for nothing."""
    if trained is None or context.method.dense:
        return
    with watch.stage("commit"):
        if frame.restarted:
            frame.memory.views.of(scene.splats)
        else:
            frame.memory.views.update(scene.splats, trained.kept, frame.scene.state.ids, scene.state.ids)


def next_memory(
    context: Context,
    frame: PendingFrame,
    plan: FramePlan,
    scene: Scene,
    trained: TrainedFrame | None,
    written: Written,
    watch: Stopwatch,
) -> Memory:
    """The memory after a frame whose new ``scene`` is drawn, and all that is left of the ``written`` frame."""
    memory = frame.memory
    return replace(
        memory,
        masks=_masks_after(context, frame, plan, scene, trained),
        motion=_motion_after(frame, plan, scene),
        corrections=_corrections_after(context, frame, plan, scene, watch),
        rate=None if memory.rate is None else memory.rate.after(written.packet.kind, written.packet.size),
        # Last, since what comes before takes time. That of an earlier encode is not known.
        time=memory.time if frame.replayed is not None else _time_after(memory.time, plan, trained, watch),
    )


def _masks_after(
    context: Context, frame: PendingFrame, plan: FramePlan, scene: Scene, trained: TrainedFrame | None
) -> MaskMemory:
    memory, settings = frame.memory.masks, context.settings.frame.masks
    # Training that was rejected, or whose changes were all reverted, has made up for nothing.
    if trained is not None and plan.masks and not same_values(frame.scene.state, scene.state):
        rendered = frame.memory.views.pictures(scene.splats) if trained.truncated or plan.relit else None
        moved = "motion" in plan.effects
        memory = memory.trained(
            frame.pictures, plan.masks, moved=moved, rendered=rendered, relit=plan.relit, threads=context.threads
        )
    return memory.advance(frame.pictures, plan.masks, settings, deferred=plan.deferred)


def _motion_after(frame: PendingFrame, plan: FramePlan, scene: Scene) -> Motion:
    """Velocities: those of a deferred frame continue."""
    if frame.restarted:
        # The displacement since the first frame is no velocity.
        return Motion.at_rest(len(scene.state))
    motion = frame.memory.motion
    return motion.defer() if plan.deferred else motion.move(scene.displacements(frame.scene.state))


def _corrections_after(
    context: Context, frame: PendingFrame, plan: FramePlan, scene: Scene, watch: Stopwatch
) -> CorrectionMemory | None:
    corrections = frame.memory.corrections
    if context.corrector is None or corrections is None or not plan.masks:
        return corrections
    with watch.stage("corrections"):
        changed = [mask.dilated for mask in plan.masks]
        render = context.renderer(frame.memory.views, scene.splats)
        return context.corrector.judge(corrections, frame.recorded.training, frame.corrections, render, changed)


def _time_after(
    time: TimeControl | None, plan: FramePlan, trained: TrainedFrame | None, watch: Stopwatch
) -> TimeControl | None:
    if time is None:
        return None
    pace = None if trained is None else trained.pace
    return time.record_time(watch.seconds, deferred=plan.deferred, pace=pace)
