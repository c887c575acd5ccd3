"""The state that one frame hands to the next and a decoder does not need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from decogs.codec.scene.state import State
from decogs.formats.splats import FloatArray
from decogs.rig.stage.stage import Stage

from ..backends.scene_views import SceneViews
from ..change.masks import MaskMemory
from ..coding.rate_control import RateControl
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation import CorrectionMemory
from ..stopwatch import Stopwatch
from ..training.method import FrameTrainer, training_context
from .context import Context
from .first_look import FirstLook, Looking
from .segment_starts import SceneStart, SegmentStarts


@dataclass(frozen=True)
class BeforeFlash:
    """The scene and the masks before the frame ``since``, which changed nearly everything."""

    since: int
    state: State
    masks: MaskMemory


@dataclass(frozen=True)
class Memory:
    """What a frame hands to the next.

    ``views``: the training views, which keep what was drawn last. ``starts``: where closed segments start from; None in
    other streams. ``rate`` and ``time`` keep to budgets, where there are some. ``stage``: the scene's, if it is one.
    ``looking``: at the next frame.
    """

    trainer: FrameTrainer
    masks: MaskMemory
    corrections: CorrectionMemory | None
    rate: RateControl | None
    time: TimeControl | None
    views: SceneViews
    stage: Stage | None = None
    before_flash: BeforeFlash | None = None
    starts: SegmentStarts | None = None
    looking: Looking | None = None

    def first_look(self, pictures: Sequence[FloatArray]) -> FirstLook | None:
        """The look that was taken of the frame with these ``pictures``, if one was, and if this is what preceded it."""
        look = None if self.looking is None else self.looking.taken()
        return look if look is not None and look.is_of(self.masks, pictures) else None


def new_memory(
    context: Context,
    scene: Scene,
    start: SceneStart,
    *,
    views: SceneViews,
    time: TimeControl | None,
    starts: SegmentStarts | None,
) -> Memory:
    """The memory after the ``start`` of a ``scene``: nothing is left of the frames before."""
    settings = context.settings
    rendered = None if context.method.dense else views.pictures(scene.splats)
    trainer = context.method.trainer(
        training_context(
            context.kernel,
            context.ingest.views,
            views,
            settings,
            scene.splats,
            seed=context.seed,
            threads=context.threads,
        )
    )
    budget = settings.frame_budget
    return Memory(
        trainer,
        MaskMemory.begin(
            start.frame.training,
            rendered,
            recorded=[view.recorded for view in context.ingest.views],
            subject=bool(start.frame.alpha),
            threads=context.threads,
        ),
        start.corrections,
        None if budget is None else RateControl(budget, settings.segment),
        time,
        views,
        start.stage,
        starts=starts,
    )


def restart_at_segment(
    context: Context, scene: Scene, memory: Memory, frame: int, watch: Stopwatch
) -> tuple[Scene, Memory, bool]:
    """Scene and memory before ``frame``, and whether it begins a closed segment.

    Such a frame starts from the first keyframe; nothing is left of the frames before it.
    """
    if memory.starts is None or frame % context.settings.segment:
        return scene, memory, False
    return *restart_from(context, scene, memory, memory.starts.first, frame, watch), True


def restart_from(
    context: Context, scene: Scene, memory: Memory, start: SceneStart, frame: int, watch: Stopwatch
) -> tuple[Scene, Memory]:
    """Scene and memory before ``frame``, which begins a closed segment that starts from there."""
    with watch.stage("commit"):
        scene = scene.restart(start.state, frame, context.settings.segment)
        corrections = None if start.corrections is None else start.corrections.restart()
        start, starts = replace(start, corrections=corrections), memory.starts
        return scene, new_memory(context, scene, start, views=memory.views, time=memory.time, starts=starts)
