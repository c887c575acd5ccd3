"""The state that one frame hands to the next and a decoder does not need."""

from __future__ import annotations

from dataclasses import dataclass

from decogs.codec.state import State

from ..change.masks import MaskMemory
from ..coding.rate_control import RateControl
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation import CorrectionMemory
from ..input.ingest import RigFrame
from ..keyframe.backdrop.stage import Stage, find_stage
from ..stopwatch import Stopwatch
from ..training.method import FrameTrainer, training_context
from ..training.warm_start import Motion
from .context import Context
from .segment_starts import SegmentStart


@dataclass(frozen=True)
class BeforeFlash:
    """The scene, its motion and the masks before the frame ``since``, which changed nearly everything."""

    since: int
    state: State
    motion: Motion
    masks: MaskMemory


@dataclass(frozen=True)
class Memory:
    """What a frame hands to the next.

    ``first``: the stream's first frame, to which closed segments return; None in other streams. ``rate`` and ``time``
    keep to budgets, where there are some. ``stage``: the scene's, if it is one.
    """

    trainer: FrameTrainer
    masks: MaskMemory
    motion: Motion
    corrections: CorrectionMemory | None
    rate: RateControl | None
    time: TimeControl | None
    stage: Stage | None = None
    before_flash: BeforeFlash | None = None
    first: SegmentStart | None = None


def new_memory(
    context: Context,
    scene: Scene,
    frame: RigFrame,
    corrections: CorrectionMemory | None,
    *,
    time: TimeControl | None,
    first: SegmentStart | None,
) -> Memory:
    """The memory after a ``scene``'s first ``frame``, compensated: nothing is left of the frames before."""
    settings = context.settings
    rendered = None if context.method.dense else context.views.pictures(scene.splats)
    trainer = context.method.trainer(
        training_context(
            context.kernel,
            context.ingest.views,
            context.views,
            settings,
            scene.splats,
            seed=context.seed,
            threads=context.threads,
        )
    )
    budget = settings.frame_budget
    return Memory(
        trainer,
        MaskMemory.begin(frame.training, rendered, subject=bool(frame.alpha)),
        Motion.at_rest(len(scene.state)),
        corrections,
        None if budget is None else RateControl(budget, settings.segment),
        time,
        None if context.method.dense else find_stage(context.ingest.views, frame),
        first=first,
    )


def restart_at_segment(
    context: Context, scene: Scene, memory: Memory, frame: int, watch: Stopwatch
) -> tuple[Scene, Memory, bool]:
    """Scene and memory before ``frame``, and whether it begins a closed segment.

    Such a frame starts from the first keyframe; nothing is left of the frames before it.
    """
    if memory.first is None or frame % context.settings.segment:
        return scene, memory, False
    return *restart_from(context, scene, memory, memory.first, frame, watch), True


def restart_from(
    context: Context, scene: Scene, memory: Memory, start: SegmentStart, frame: int, watch: Stopwatch
) -> tuple[Scene, Memory]:
    """Scene and memory before ``frame``, which begins a closed segment that starts from there."""
    with watch.stage("commit"):
        scene = scene.restart(start.state, frame, context.settings.segment)
        corrections = None if start.corrections is None else start.corrections.restart()
        return scene, new_memory(context, scene, start.frame, corrections, time=memory.time, first=memory.first)
