"""One frame from its pictures to its packet, in ten steps.

A frame that an earlier encode wrote takes the same steps, with its packet in place of training. So does one of the next
closed segment, with a memory of its own. Every step takes frozen values and returns new ones.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import State, changed_between
from decogs.formats.errors import TrainingError
from decogs.formats.rigs import is_live
from decogs.formats.splats import FloatArray, Splats, empty_splats
from decogs.formats.stream.container import Packet, PacketKind
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.ingest import RigFrame, scene_extent
from decogs.rig.stage.stage import Stage

from ..change.masks import FrameMask, usable_views
from ..coding.packets import Written, frame_packet, key_packet, read_back
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation import CorrectionMemory
from ..input.compensation.frame import compensate, find_corrections, match_colours, newly_dropped, without_lamps
from ..input.rolled_pictures import at_one_instant
from ..keyframe.first_frame import FirstFrame, stage_of_keyframe, train_first_frame
from ..output.reports import OnKeyframeStep
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from .commit import look_ahead, next_memory, redraw
from .context import Context
from .cross_fade import CrossFade, cross_fade
from .events import Kind, PendingFrame, what_happened
from .first_look import Upcoming
from .memory import Memory, new_memory, restart_at_segment, restart_from
from .plan import FramePlan, find_masks, find_selected, plan_frame
from .segment_starts import SceneStart, SegmentStarts
from .train import train_frame


class Following(Protocol):
    """The segment after a frame's own."""

    def fade(self, frame: int, scene: Scene) -> CrossFade | None:
        """The cross-fade of the rig's ``frame``, which starts from ``scene``; None where there is none."""
        ...


def _nowhere(packet: Packet) -> None:
    pass


@dataclass(frozen=True)
class Task:
    """A frame to encode, as ``recorded``; ``packet``: what an earlier encode made of it, instead of training.

    ``following``: the closed segment that it is faded towards, if any. ``on_step`` follows the training of a keyframe.
    ``write`` takes the packet. ``upcoming``: the next frame, to be looked at meanwhile.
    """

    recorded: RigFrame
    packet: Packet | None = None
    following: Following | None = None
    on_step: OnKeyframeStep | None = None
    watch: Stopwatch = field(default_factory=Stopwatch)
    write: Callable[[Packet], None] = _nowhere
    upcoming: Upcoming | None = None


@dataclass(frozen=True)
class Encoded:
    """An encoded frame: its packet, the scene that a decoder then has, the next frame's memory, and what was done.

    ``pictures``: the frame, compensated. ``selected``: share of the Gaussians in S_t. ``effects``: those that it was
    trained for. ``full_frame_change``: the masks missed a change of most of the pictures. ``cut``: it is a keyframe of
    another scene. ``rejected``: training made the pictures worse, and changed nothing. ``uncorrected``: corrections
    that ended with it.
    """

    written: Written
    scene: Scene
    memory: Memory
    pictures: RigFrame
    masks: Sequence[FrameMask] = ()
    selected: float = 1.0
    effects: tuple[str, ...] = ()
    full_frame_change: bool = False
    cut: bool = False
    rejected: bool = False
    uncorrected: Sequence[str] = ()


def encode_frame(context: Context, scene: Scene, memory: Memory, task: Task) -> Encoded:
    """Encodes a later frame of a stream from the scene before it."""
    frame = compensate_and_classify(context, scene, memory, task)
    if frame.kind is Kind.CUT:
        try:
            return encode_cut(context, frame, task)
        except TrainingError:
            # Such as pictures in which no points are found: the frame is trained as others are.
            frame = replace(frame, kind=Kind.CHANGE)
    return train_and_code(context, frame, task)


def compensate_and_classify(context: Context, scene: Scene, memory: Memory, task: Task) -> PendingFrame:
    """Steps 2 and 3: the compensated frame, and what happened in it."""
    watch, packet = task.watch, task.packet
    index = task.recorded.index - scene.header.first_frame
    scene, memory, restarted = restart_at_segment(context, scene, memory, index, watch)
    frame = _pending(context, scene, memory, task, restarted=restarted)
    if packet is not None and frame.replayed is not None and scene.is_left_by(packet, frame.replayed):
        return replace(frame, kind=Kind.CUT)
    frame = what_happened(context, frame, watch)
    if restarted and frame.kind is Kind.CUT and (start := _start_after_cut(context, frame, task)) is not None:
        scene, memory = restart_from(context, scene, memory, start, index, watch)
        frame = what_happened(context, _pending(context, scene, memory, task, restarted=True), watch)
    # A keyframe needs every camera.
    if frame.kind is Kind.CUT and (packet is not None or len(usable_views(frame.changes)) < len(frame.changes)):
        return replace(frame, kind=Kind.CHANGE)
    return frame


def _pending(context: Context, scene: Scene, memory: Memory, task: Task, *, restarted: bool) -> PendingFrame:
    """The frame, compensated against the ``scene`` before it, or as its packet says."""
    recorded = match_colours(task.recorded, context.ingest.views, scene.header.camera_colours)
    recorded, state = _without_lost(context, recorded, memory), None
    if task.packet is not None:
        _, corrections = read_back(task.packet, scene.header)
        state = scene.read(task.packet)
    else:
        render = context.renderer(memory.views, scene.splats)
        corrections = find_corrections(recorded, context.corrector, memory.corrections, render, task.watch)
    compensated = compensate(recorded, context.corrector, corrections)
    return PendingFrame(recorded, compensated, corrections, scene, memory, restarted=restarted, replayed=state)


def _start_after_cut(context: Context, frame: PendingFrame, task: Task) -> SceneStart | None:
    """Where the closed segment starts that begins with the ``frame``, another scene than the first keyframe's."""
    starts = frame.memory.starts
    assert starts is not None
    scene = replace(frame.scene, state=starts.first.state)

    def train(recorded: RigFrame) -> SceneStart | None:
        cut = Task(recorded, on_step=task.on_step, watch=task.watch)
        try:
            return _start_of(encode_cut(context, replace(frame, scene=scene, replayed=None), cut))
        except TrainingError:
            return None

    return starts.before(task.recorded, train)


def _without_lost(context: Context, frame: RigFrame, memory: Memory) -> RigFrame:
    """The frame with the pictures before it in place of lost ones."""
    if not frame.lost:
        return frame
    views = zip(context.ingest.views, frame.training, memory.masks.previous, strict=True)
    kept = [before if view.camera.name in frame.lost else now for view, now, before in views]
    return replace(frame, training=kept)


def train_and_code(context: Context, frame: PendingFrame, task: Task) -> Encoded:
    """Steps 4 to 10: the regions that changed, the Gaussians in them, their training, the packet."""
    watch, packet, state = task.watch, task.packet, frame.replayed
    fade = None if task.following is None else task.following.fade(frame.recorded.index, frame.scene)
    masks = find_masks(context, frame, watch)
    selected = find_selected(context, frame, masks, watch)
    plan = plan_frame(context, frame, masks, selected, fade, watch)
    looking = None
    if packet is None or state is None:
        looking = None if task.upcoming is None else look_ahead(context, frame, plan, task.upcoming)
        before, trained = train_frame(context, frame, plan, watch) if plan.trains else (frame.scene, None)
        if fade is not None:
            trained = _fade(context, frame, plan, before, trained, fade, watch)
        written, scene = _code(context, frame, plan, before, trained, watch)
    else:
        written, scene, plan, trained = _replay(context, frame, plan, packet, state)
    with watch.stage("write"):
        task.write(written.packet)
    redraw(context, frame, scene, trained, watch)
    memory = next_memory(context, frame, plan, scene, trained, written, watch, looking)
    return Encoded(
        written,
        scene,
        memory,
        frame.compensated,
        masks=plan.masks,
        selected=plan.share,
        effects=() if plan.deferred else plan.effects,
        full_frame_change=frame.kind is Kind.EVERYTHING and bool(frame.changes),
        rejected=trained is not None and trained.rejected,
        uncorrected=newly_dropped(frame.memory.corrections, memory.corrections),
    )


def encode_cut(context: Context, frame: PendingFrame, task: Task) -> Encoded:
    """A keyframe of another scene than the one before it; raises TrainingError where none can be trained."""
    before, starts, key, first_id = frame.scene, frame.memory.starts, frame.replayed, -1
    if starts is not None:
        number = task.recorded.index - before.header.first_frame
        first_id = before.id_of_cut(number, context.settings.segment)
        before, kept = before.before_cut(number, first_id), starts.kept(task.recorded.index)
        if kept is not None and key is None and before.state.next_id == first_id:
            key, task = kept.state, replace(task, packet=kept.packet)
    frame.memory.views.release()
    if key is not None:
        first = earlier_first_frame(context, key, before.header, task.recorded)
    else:
        recorded = match_colours(task.recorded, context.ingest.views, before.header.camera_colours)
        first = train_keyframe(context, recorded, task, replace(frame, scene=before))
        first = replace(first, state=replace(first.state, frame=before.state.frame + 1))
    encoded = begin_scene(context, before.header, first, task, replace(frame, scene=before))
    if starts is not None and first_id in encoded.scene.state.ids[:1]:
        starts.keep(_start_of(encoded))
    return encoded


def _start_of(encoded: Encoded) -> SceneStart:
    """A scene's first frame as what closed segments start from."""
    memory = encoded.memory
    return SceneStart(encoded.scene.state, encoded.written.packet, encoded.pictures, memory.corrections, memory.stage)


def train_keyframe(context: Context, recorded: RigFrame, task: Task, before: PendingFrame | None = None) -> FirstFrame:
    """The Gaussians of a stream's first frame, or of one that shows another scene than that ``before`` it."""
    corrections = None if before is None else before.memory.corrections
    steady = _steady(context, recorded, corrections)
    first = train_first_frame(
        context.kernel,
        context.ingest,
        steady,
        context.settings,
        task.watch,
        seed=context.seed,
        threads=context.threads,
        corrector=context.corrector,
        stopping=context.stopping(),
        on_step=task.on_step,
        header=None if before is None else before.scene.header,
        first_id=0 if before is None else before.scene.state.next_id,
    )
    if steady is recorded:
        return first
    return replace(first, recorded=match_colours(recorded, context.ingest.views, first.colours))


def _steady(context: Context, recorded: RigFrame, memory: CorrectionMemory | None) -> RigFrame:
    """A keyframe's pictures in the mean light of its lamps, and at one instant where the next frame is there."""
    ingest, corrector = context.ingest, context.corrector
    frame, times = without_lamps(recorded, ingest.rate, corrector, memory), context.row_times()
    if not times or is_live(ingest.rig) or frame.index + 1 >= ingest.rig.frame_count:
        return frame
    later = next(ingest.frames(frame.index + 1, frame.index + 2, first=frame.index))
    later = without_lamps(later, ingest.rate, corrector, memory)
    with side_by_side(context.threads) as each:
        return at_one_instant(frame, later, ingest.views, times, each)


def earlier_first_frame(context: Context, key: State, header: StreamHeader, recorded: RigFrame) -> FirstFrame:
    """The first frame whose Gaussians, the ``key``'s, an earlier encode trained."""
    colours, views = header.camera_colours, context.ingest.views
    matched = match_colours(recorded, views, colours)
    means = dequantise(key, header.lattice).means
    stage = None if context.method.dense else stage_of_keyframe(views, matched, means)
    return FirstFrame(key, header.lattice, colours, matched, stage)


def begin_scene(
    context: Context, header: StreamHeader, first: FirstFrame, task: Task, cut: PendingFrame | None = None
) -> Encoded:
    """The ``first`` frame of a stream, or of another scene after a ``cut``."""
    watch, packet, corrector = task.watch, task.packet, context.corrector
    key, drift = first.state, None
    splats = dequantise(key, header.lattice)
    if corrector is not None:
        views = context.ingest.views
        drift = corrector.begin(lambda number: context.kernel.forward(splats, views[number].pinhole, depth=True))
    if packet is not None:
        written, corrections = read_back(packet, header)
    else:
        corrections = find_corrections(first.recorded, corrector, drift, context.fresh_renderer(splats), watch)
        with watch.stage("write"):
            written = key_packet(header, key, corrections)
    frame = compensate(first.recorded, corrector, corrections)
    with watch.stage("commit"):
        if packet is None:
            key = reconstruct(None, written.packet, header) if cut is None else cut.scene.read(written.packet)
        scene = Scene.open(header, key) if cut is None else cut.scene.after(key)
        drift = None if drift is None else drift.begin(corrections, task.recorded.index)
        start = SceneStart(key, written.packet, frame, drift, _stage_of(context, first, frame, splats.means))
        memory = (
            _first_memory(context, scene, start)
            if cut is None
            else new_memory(
                context, scene, start, views=cut.memory.views, time=cut.memory.time, starts=cut.memory.starts
            )
        )
    with watch.stage("write"):
        task.write(written.packet)
    return Encoded(written, scene, memory, frame, cut=cut is not None)


def _stage_of(context: Context, first: FirstFrame, compensated: RigFrame, means: FloatArray) -> Stage | None:
    """The stage in the ``compensated`` pictures: the one that training found, unless these are others."""
    same = all(map(operator.is_, first.recorded.training, compensated.training))
    return first.stage if same or context.method.dense else stage_of_keyframe(context.ingest.views, compensated, means)


def _first_memory(context: Context, scene: Scene, start: SceneStart) -> Memory:
    """The memory after a stream's first frame."""
    settings = context.settings
    return new_memory(
        context,
        scene,
        start,
        views=context.new_views(),
        time=None if settings.time_budget is None else TimeControl(settings.time_budget),
        starts=SegmentStarts(context.ingest, settings.segment, start) if settings.closed else None,
    )


def _fade(
    context: Context,
    frame: PendingFrame,
    plan: FramePlan,
    before: Scene,
    trained: TrainedFrame | None,
    fade: CrossFade,
    watch: Stopwatch,
) -> TrainedFrame:
    """Step 8: what the frame changes of the scene ``before`` it, trained further towards the ``fade``'s mixture."""
    with watch.stage("training"):
        if trained is None:
            frame.memory.views.of(before.splats)
        frame.memory.views.detach(fade.rows)
        return cross_fade(
            context.kernel,
            before.splats,
            trained or _no_change(before.splats),
            fade,
            plan.settings,
            extent=scene_extent(context.ingest.views) or 1.0,
            seed=(context.seed, frame.index),
            on_loss=context.on_loss,
        )


def _code(
    context: Context,
    frame: PendingFrame,
    plan: FramePlan,
    before: Scene,
    trained: TrainedFrame | None,
    watch: Stopwatch,
) -> tuple[Written, Scene]:
    """Step 9: the packet of what was ``trained`` of the scene ``before`` it, and the scene as a decoder then has it."""
    with watch.stage("write"):
        written = frame_packet(
            before,
            frame.index,
            trained,
            plan.settings.significance,
            frame.corrections,
            segment=context.settings.segment,
            whole=frame.is_return,
        )
        return written, before.after(before.read(written.packet))


def _no_change(scene: Splats) -> TrainedFrame:
    rows, empty = np.zeros(0, np.int64), empty_splats(scene.sh_degree)
    return TrainedFrame(rows, empty, rows, empty)


def _replay(
    context: Context, frame: PendingFrame, plan: FramePlan, packet: Packet, state: State
) -> tuple[Written, Scene, FramePlan, TrainedFrame | None]:
    """Steps 7 to 9 of an earlier encode, as its packet states: packet, scene, the plan, and what was trained."""
    before = frame.scene
    written, _ = read_back(packet, before.header)
    scene = before.after(state)
    # Those that a cross-fade changes are not among those that the masks select.
    changed = changed_between(before.state, scene.state)
    is_trained = bool(plan.effects) or bool(changed.any())
    # A deferred frame's changes are still to be trained. With a time budget, a skip in place of changes signals it.
    deferred = is_trained and context.settings.time_budget is not None and packet.kind == PacketKind.SKIP
    plan = replace(plan, deferred=deferred)
    if not is_trained or deferred:
        return written, scene, plan, None
    rows = np.flatnonzero(plan.selected | changed)
    if not context.method.dense:
        frame.memory.views.of(before.splats).detach(rows)
    return written, scene, plan, replace(_no_change(before.splats), kept=rows)
