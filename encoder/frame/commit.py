"""The end of a frame: the views are updated to the new scene, and the next frame gets its memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from decogs.codec.scene.state import same_values
from decogs.formats.splats import FloatArray

from ..change.masks import MaskMemory
from ..coding.packets import Written
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation import CorrectionMemory
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from .context import Context
from .events import PendingFrame
from .first_look import Looking, Upcoming, begin_looking
from .memory import Memory
from .plan import FramePlan

_COMPARED_EVERY = 4
"""Frames, of which one is compared with its pictures. One of eight loses .3 dB on a plain stage, .24 where light
changes; each takes a quarter more bytes."""

_LOOKING_SHARE = 4
"""Of the threads, one in so many looks ahead: it has all of the training for it, which threads of Python's hold up."""


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
    looking: Looking | None = None,
) -> Memory:
    """The memory after a frame whose new ``scene`` is drawn, and all that is left of the ``written`` frame.

    ``looking``: at the next frame, meanwhile.
    """
    memory = frame.memory
    # Training that was rejected, or whose changes were all reverted, has made up for nothing.
    stands = trained is not None and bool(plan.masks) and not same_values(frame.scene.state, scene.state)
    if trained is None or not stands or trained.truncated:
        looking = None
    if looking is not None:
        masks = looking.memory.result()
    else:
        masks = _masks_after(context, frame, plan, scene, trained if stands else None)
    return replace(
        memory,
        masks=masks,
        looking=looking,
        corrections=_corrections_after(context, frame, plan, scene, watch),
        rate=None if memory.rate is None else memory.rate.after(written.packet.kind, written.packet.size),
        # Last, since what comes before takes time. That of an earlier encode is not known.
        time=memory.time if frame.replayed is not None else _time_after(memory.time, plan, trained, watch),
    )


def look_ahead(context: Context, frame: PendingFrame, plan: FramePlan, upcoming: Upcoming) -> Looking | None:
    """Begins to look at the next frame if it is known what this one, once trained, hands on to its masks."""
    compensated = context.corrector is not None or frame.scene.header.camera_colours
    if compensated or not plan.trains or _is_compared(frame, plan) or frame.memory.time is not None or not plan.masks:
        return None
    threads = max(1, context.threads // _LOOKING_SHARE)
    return begin_looking(
        lambda: _trained_masks(context, frame, plan, None), upcoming, context.kernel, context.settings, threads
    )


def _is_compared(frame: PendingFrame, plan: FramePlan) -> bool:
    """Whether pixels that training misses are to be selected again, though they may change no more.

    Edges that move slowly leave some: Gaussians there take the background's colour, and stay.
    """
    return plan.relit or frame.index % _COMPARED_EVERY == 0


def _trained_masks(
    context: Context, frame: PendingFrame, plan: FramePlan, rendered: Sequence[FloatArray] | None
) -> MaskMemory:
    memory = frame.memory.masks.trained(
        frame.pictures,
        plan.masks,
        moved="motion" in plan.effects,
        rendered=rendered,
        relit=plan.relit,
        threads=context.threads,
    )
    return memory.advance(frame.pictures, plan.masks, context.settings.frame.masks, deferred=plan.deferred)


def _masks_after(
    context: Context, frame: PendingFrame, plan: FramePlan, scene: Scene, trained: TrainedFrame | None
) -> MaskMemory:
    if trained is not None:
        is_compared = trained.truncated or _is_compared(frame, plan)
        rendered = frame.memory.views.pictures(scene.splats) if is_compared else None
        return _trained_masks(context, frame, plan, rendered)
    return frame.memory.masks.advance(frame.pictures, plan.masks, context.settings.frame.masks, deferred=plan.deferred)


def _corrections_after(
    context: Context, frame: PendingFrame, plan: FramePlan, scene: Scene, watch: Stopwatch
) -> CorrectionMemory | None:
    corrections = frame.memory.corrections
    if context.corrector is None or corrections is None:
        return corrections
    corrections = replace(corrections, latest=frame.corrections, index=frame.recorded.index)
    if not plan.masks:
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
