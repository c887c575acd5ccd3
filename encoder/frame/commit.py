"""The end of a frame: the views are updated to the new scene, and the next frame gets its memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from decogs.codec.state import same_values

from ..change.masks import MaskMemory
from ..coding.scene import Scene
from ..input.compensation.frame import newly_dropped
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from ..training.warm_start import Motion
from .context import Context
from .events import Event, Kind, PendingFrame
from .memory import Memory
from .plan import FramePlan, Selection


@dataclass(frozen=True)
class Outcome:
    """A frame's outcome: what was selected, and the ``effects`` that it was trained for.

    ``full_frame_change``: the masks missed a change of most of the pictures. ``cut``: it is a keyframe of another
    scene. ``deferred``: its training waits for time. ``rejected``: training made the pictures worse, and changed
    nothing. ``uncorrected``: corrections that ended with it.
    """

    selection: Selection
    effects: tuple[str, ...] = ()
    full_frame_change: bool = False
    cut: bool = False
    deferred: bool = False
    rejected: bool = False
    uncorrected: Sequence[str] = ()


def commit(
    context: Context,
    event: Event,
    plan: FramePlan,
    frame: PendingFrame,
    scene: Scene,
    trained: TrainedFrame | None,
    watch: Stopwatch,
) -> tuple[Memory, Outcome]:
    """The memory after a frame whose new ``scene`` stands; ``trained``: what training changed, None for none."""
    memory, before = event.memory, event.scene
    if trained is not None and not context.method.dense:
        with watch.stage("commit"):
            if frame.restarted:
                context.views.of(scene.splats)
            else:
                context.views.update(scene.splats, trained.kept, before.state.ids, scene.state.ids)
    memory = replace(
        memory,
        masks=_masks_after(context, event, plan, frame, scene, trained),
        motion=_motion_after(memory.motion, plan, frame, before, scene),
    )
    uncorrected: Sequence[str] = ()
    if context.corrector is not None and memory.corrections is not None and plan.selection.masks:
        with watch.stage("corrections"):
            changed = [mask.dilated for mask in plan.selection.masks]
            judged = context.corrector.judge(
                memory.corrections, frame.recorded.training, frame.corrections, context.renderer(scene.splats), changed
            )
            uncorrected = newly_dropped(memory.corrections, judged)
            memory = replace(memory, corrections=judged)
    outcome = Outcome(
        plan.selection,
        () if plan.deferred else plan.effects,
        full_frame_change=event.kind is Kind.EVERYTHING and bool(event.changes),
        deferred=plan.deferred,
        rejected=trained is not None and trained.rejected,
        uncorrected=uncorrected,
    )
    return memory, outcome


def _masks_after(
    context: Context,
    event: Event,
    plan: FramePlan,
    frame: PendingFrame,
    scene: Scene,
    trained: TrainedFrame | None,
) -> MaskMemory:
    memory, settings, masks = event.memory.masks, context.settings.frame.masks, plan.selection.masks
    # Training that was rejected, or whose changes were all reverted, has made up for nothing.
    if trained is not None and masks and not same_values(event.scene.state, scene.state):
        rendered = context.views.pictures(scene.splats) if trained.truncated or plan.relit else None
        moved = "motion" in plan.effects
        memory = memory.trained(
            frame.pictures, masks, moved=moved, rendered=rendered, relit=plan.relit, threads=context.threads
        )
    return memory.advance(frame.pictures, masks, settings, deferred=plan.deferred)


def _motion_after(motion: Motion, plan: FramePlan, frame: PendingFrame, before: Scene, scene: Scene) -> Motion:
    """Velocities: those of a deferred frame continue."""
    if frame.restarted:
        # The displacement since the first frame is no velocity.
        return Motion.at_rest(len(scene.state))
    return motion.defer() if plan.deferred else motion.move(scene.displacements(before.state))
