"""The end of a frame: the views are updated to the new scene, and the next frame gets its memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from decogs.codec.state import same_values
from decogs.formats.splats import FloatArray

from ..change.masks import MaskMemory
from ..coding.scene import Scene
from ..input.compensation.frame import newly_dropped
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from ..training.warm_start import Motion
from .context import Context
from .events import Event, Kind, PendingFrame
from .first_look import Looking, Upcoming, begin_looking
from .memory import Memory
from .plan import FramePlan, Selection

_LOOKING_SHARE = 4
"""Of the threads, one in so many looks ahead: it has all of the training for it, which threads of Python's hold up."""


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
    looking: Looking | None = None,
) -> tuple[Memory, Outcome]:
    """The memory after a frame whose new ``scene`` stands; ``trained``: what training changed, None for none.

    ``looking``: at the next frame, meanwhile.
    """
    memory, before = event.memory, event.scene
    if trained is not None and not context.method.dense:
        with watch.stage("commit"):
            if frame.restarted:
                context.views.of(scene.splats)
            else:
                context.views.update(scene.splats, trained.kept, before.state.ids, scene.state.ids)
    # Training that was rejected, or whose changes were all reverted, has made up for nothing.
    stands = trained is not None and bool(plan.selection.masks) and not same_values(before.state, scene.state)
    if looking is not None and trained is not None and stands and not trained.truncated:
        memory = replace(memory, masks=looking.memory.result(), looking=looking)
    else:
        masks = _masks_after(context, event, plan, frame, scene, trained if stands else None)
        memory = replace(memory, masks=masks, looking=None)
    memory = replace(memory, motion=_motion_after(memory.motion, plan, frame, before, scene))
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


def look_ahead(
    context: Context, event: Event, plan: FramePlan, frame: PendingFrame, upcoming: Upcoming
) -> Looking | None:
    """Begins to look at the next frame if it is known what this one, once trained, hands on to its masks."""
    compensated = context.corrector is not None or event.scene.header.camera_colours
    if compensated or not plan.trains or plan.relit or event.memory.time is not None or not plan.selection.masks:
        return None

    def hand_on() -> MaskMemory:
        return _trained_masks(context, event, plan, frame, None)

    return begin_looking(hand_on, upcoming, context.kernel, context.settings, max(1, context.threads // _LOOKING_SHARE))


def _trained_masks(
    context: Context, event: Event, plan: FramePlan, frame: PendingFrame, rendered: Sequence[FloatArray] | None
) -> MaskMemory:
    masks, moved = plan.selection.masks, "motion" in plan.effects
    memory = event.memory.masks.trained(frame.pictures, masks, moved=moved, rendered=rendered, threads=context.threads)
    return memory.advance(frame.pictures, masks, context.settings.frame.masks, deferred=plan.deferred)


def _masks_after(
    context: Context,
    event: Event,
    plan: FramePlan,
    frame: PendingFrame,
    scene: Scene,
    trained: TrainedFrame | None,
) -> MaskMemory:
    memory, settings, masks = event.memory.masks, context.settings.frame.masks, plan.selection.masks
    if trained is not None:
        rendered = context.views.pictures(scene.splats) if trained.truncated or plan.relit else None
        return _trained_masks(context, event, plan, frame, rendered)
    return memory.advance(frame.pictures, masks, settings, deferred=plan.deferred)


def _motion_after(motion: Motion, plan: FramePlan, frame: PendingFrame, before: Scene, scene: Scene) -> Motion:
    """Velocities: those of a deferred frame continue."""
    if frame.restarted:
        # The displacement since the first frame is no velocity.
        return Motion.at_rest(len(scene.state))
    return motion.defer() if plan.deferred else motion.move(scene.displacements(before.state))
