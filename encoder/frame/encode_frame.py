"""One frame from its pictures to its packet, in ten steps.

A frame that an earlier encode wrote takes the same steps, with its packet in place of training. So does one of the next
closed segment, with a memory of its own. Every step takes frozen values and returns new ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from decogs.codec.header import StreamHeader
from decogs.codec.lattice import dequantise
from decogs.codec.state import State, changed_between
from decogs.formats.container import Packet, PacketKind
from decogs.formats.errors import TrainingError
from decogs.formats.splats import Splats, empty_splats

from ..change.masks import usable_views
from ..coding.packets import Written, frame_packet, key_packet, read_back
from ..coding.scene import Scene
from ..coding.time_control import TimeControl
from ..input.compensation.frame import compensate, find_corrections, match_colours
from ..input.ingest import RigFrame, scene_extent
from ..keyframe.first_frame import FirstFrame, train_first_frame
from ..output.reports import OnKeyframeStep
from ..stopwatch import Stopwatch
from ..training.method import TrainedFrame
from .commit import Outcome, commit
from .context import Context
from .cross_fade import CrossFade, cross_fade
from .events import Event, Kind, PendingFrame, what_happened
from .memory import Memory, new_memory, restart_at_segment, restart_from
from .plan import FramePlan, Selection, find_selection, plan_frame
from .segment_starts import SegmentStart
from .train import train_frame


class Following(Protocol):
    """The segment after a frame's own."""

    def fade(self, frame: int, scene: Scene) -> CrossFade | None:
        """The cross-fade of the rig's ``frame``, which starts from ``scene``; None where there is none."""
        ...


@dataclass(frozen=True)
class Task:
    """A frame to encode, as ``recorded``; ``packet``: what an earlier encode made of it, instead of training.

    ``following``: the closed segment that it is faded towards, if any. ``on_step`` follows the training of a keyframe.
    """

    recorded: RigFrame
    packet: Packet | None = None
    following: Following | None = None
    on_step: OnKeyframeStep | None = None
    watch: Stopwatch = field(default_factory=Stopwatch)


@dataclass(frozen=True)
class Encoded:
    """An encoded frame: its packet, the scene that a decoder then has, the next frame's memory, and its outcome.

    ``pictures``: the frame, compensated.
    """

    written: Written
    scene: Scene
    memory: Memory
    outcome: Outcome
    pictures: RigFrame


def encode_frame(context: Context, scene: Scene, memory: Memory, task: Task) -> Encoded:
    """Encodes a later frame of a stream from the scene before it."""
    frame, event = observe(context, scene, memory, task)
    if event.kind is Kind.CUT:
        try:
            return encode_cut(context, event, task)
        except TrainingError:
            # Such as pictures in which no points are found: the frame is trained as others are.
            event = replace(event, kind=Kind.CHANGE)
    return encode_change(context, event, frame, task)


def observe(context: Context, scene: Scene, memory: Memory, task: Task) -> tuple[PendingFrame, Event]:
    """Steps 2 and 3: the compensated frame, and what happened in it."""
    index = task.recorded.index - scene.header.first_frame
    scene, memory, is_start = restart_at_segment(context, scene, memory, index, task.watch)
    frame = _pending(context, scene, memory, task, restarted=is_start)
    if task.packet is not None and scene.begins_anew(task.packet):
        return frame, Event(Kind.CUT, scene, memory, [])
    event = what_happened(context, scene, memory, frame, task.watch)
    if is_start and event.kind is Kind.CUT and (start := _start_after_cut(context, event, task)) is not None:
        scene, memory = restart_from(context, scene, memory, start, index, task.watch)
        frame = _pending(context, scene, memory, task, restarted=True)
        event = what_happened(context, scene, memory, frame, task.watch)
    # A keyframe needs every camera.
    if event.kind is Kind.CUT and (task.packet is not None or len(usable_views(event.changes)) < len(event.changes)):
        event = replace(event, kind=Kind.CHANGE)
    return frame, event


def _pending(context: Context, scene: Scene, memory: Memory, task: Task, *, restarted: bool) -> PendingFrame:
    """The frame, compensated against the ``scene`` before it, or as its packet says."""
    recorded = match_colours(task.recorded, context.ingest.views, scene.header.camera_colours)
    recorded = _without_lost(context, recorded, memory)
    if task.packet is not None:
        _, corrections = read_back(task.packet, scene.header)
    else:
        render = context.renderer(scene.splats)
        corrections = find_corrections(recorded, context.corrector, memory.corrections, render, task.watch)
    return PendingFrame(recorded, compensate(recorded, context.corrector, corrections), corrections, restarted)


def _start_after_cut(context: Context, event: Event, task: Task) -> SegmentStart | None:
    """Where the closed segment starts that begins with the frame, another scene than the first keyframe's."""

    first = event.memory.first
    assert first is not None

    def train(recorded: RigFrame) -> SegmentStart | None:
        cut = replace(event, scene=replace(event.scene, state=first.state))
        try:
            return _start_of(encode_cut(context, cut, replace(task, recorded=recorded, packet=None)))
        except TrainingError:
            return None

    return context.starts.before(task.recorded, first.frame, train)


def _without_lost(context: Context, frame: RigFrame, memory: Memory) -> RigFrame:
    """The frame with the pictures before it in place of lost ones."""
    if not frame.lost:
        return frame
    views = zip(context.ingest.views, frame.training, memory.masks.previous, strict=True)
    kept = [before if view.camera.name in frame.lost else now for view, now, before in views]
    return replace(frame, training=kept)


def encode_change(context: Context, event: Event, frame: PendingFrame, task: Task) -> Encoded:
    """Steps 4 to 10: the regions that changed, the Gaussians in them, their training, the packet."""
    watch, packet = task.watch, task.packet
    selection = find_selection(context, event, frame, watch)
    fade = None if task.following is None else task.following.fade(frame.recorded.index, event.scene)
    plan = plan_frame(context, event, selection, frame, fade, watch)
    if packet is None:
        written, scene, trained = _train_and_code(context, event, plan, frame, fade, watch)
    else:
        written, _ = read_back(packet, event.scene.header)
        scene = event.scene.after(packet)
        plan, trained = _replay(context, event.scene, scene, plan, packet)
    memory, outcome = commit(context, event, plan, frame, scene, trained, watch)
    if memory.rate is not None:
        memory = replace(memory, rate=memory.rate.after(written.packet.kind, written.packet.size))
    return Encoded(written, scene, memory, outcome, frame.compensated)


def encode_cut(context: Context, event: Event, task: Task) -> Encoded:
    """A keyframe of another scene than the one before it; raises TrainingError where none can be trained."""
    before, first_id = event.scene, -1
    if context.settings.closed:
        frame = task.recorded.index - before.header.first_frame
        first_id = before.id_of_cut(frame, context.settings.segment)
        before, kept = before.before_cut(frame, first_id), context.starts.kept(task.recorded.index)
        if kept is not None and task.packet is None and before.state.next_id == first_id:
            task = replace(task, packet=kept.packet)
    context.views.release()
    if task.packet is not None:
        key = before.after(task.packet).state
    else:
        recorded = match_colours(task.recorded, context.ingest.views, before.header.camera_colours)
        first = train_keyframe(context, recorded, task, before)
        key = replace(first.state, frame=before.state.frame + 1)
    encoded = begin_scene(context, before.header, key, task, replace(event, scene=before))
    if first_id in encoded.scene.state.ids[:1]:
        context.starts.keep(_start_of(encoded))
    return encoded


def _start_of(encoded: Encoded) -> SegmentStart:
    """A scene's first frame as the start of closed segments."""
    return SegmentStart(encoded.scene.state, encoded.written.packet, encoded.pictures, encoded.memory.corrections)


def train_keyframe(context: Context, recorded: RigFrame, task: Task, before: Scene | None = None) -> FirstFrame:
    """The Gaussians of a stream's first frame, or of one that shows another scene than the one ``before``."""
    return train_first_frame(
        context.kernel,
        context.ingest,
        recorded,
        context.settings,
        task.watch,
        seed=context.seed,
        threads=context.threads,
        corrector=context.corrector,
        stopping=context.stopping(),
        on_step=task.on_step,
        header=None if before is None else before.header,
        first_id=0 if before is None else before.state.next_id,
    )


def begin_scene(context: Context, header: StreamHeader, key: State, task: Task, cut: Event | None = None) -> Encoded:
    """The first frame of a stream, or of another scene after a ``cut``: its Gaussians are the ``key``'s."""
    watch, packet, corrector = task.watch, task.packet, context.corrector
    splats = dequantise(key, header.lattice)
    recorded, drift = match_colours(task.recorded, context.ingest.views, header.camera_colours), None
    if corrector is not None:
        views = context.ingest.views
        drift = corrector.begin(lambda number: context.kernel.forward(splats, views[number].pinhole, depth=True))
    if packet is not None:
        written, corrections = read_back(packet, header)
    else:
        corrections = find_corrections(recorded, corrector, drift, context.fresh_renderer(splats), watch)
        with watch.stage("write"):
            written = key_packet(header, key, corrections, context.settings.zstd_level)
    scene = Scene.open(header, written.packet) if cut is None else cut.scene.after(written.packet)
    frame = compensate(recorded, corrector, corrections)
    with watch.stage("commit"):
        memory = new_memory(
            context,
            scene,
            frame,
            None if drift is None else replace(drift, first=corrections),
            time=_time_control(context) if cut is None else cut.memory.time,
            first=None if cut is None else cut.memory.first,
        )
    selection = Selection([], np.ones(len(key), bool))
    encoded = Encoded(written, scene, memory, Outcome(selection, cut=cut is not None), frame)
    if context.settings.closed and cut is None:
        encoded = replace(encoded, memory=replace(memory, first=_start_of(encoded)))
    return encoded


def _time_control(context: Context) -> TimeControl | None:
    budget = context.settings.time_budget
    return None if budget is None else TimeControl(budget)


def _train_and_code(
    context: Context, event: Event, plan: FramePlan, frame: PendingFrame, fade: CrossFade | None, watch: Stopwatch
) -> tuple[Written, Scene, TrainedFrame | None]:
    """Steps 7 to 9: what the frame changes, its packet, and the scene as a decoder then has it."""
    index = frame.recorded.index - event.scene.header.first_frame
    before, trained = train_frame(context, event, plan, frame, watch) if plan.trains else (event.scene, None)
    if fade is not None:
        with watch.stage("training"):
            if trained is None:
                context.views.of(before.splats)
            context.views.detach(fade.rows)
            trained = cross_fade(
                context.kernel,
                before.splats,
                trained or _no_change(before.splats),
                fade,
                plan.settings,
                extent=scene_extent(context.ingest.views) or 1.0,
                seed=(context.seed, index),
                on_loss=context.on_loss,
            )
    with watch.stage("write"):
        written = frame_packet(
            before,
            index,
            trained,
            plan.settings.significance,
            frame.corrections,
            context.settings,
            whole=event.is_return,
        )
        return written, before.after(written.packet), trained


def _no_change(scene: Splats) -> TrainedFrame:
    rows, empty = np.zeros(0, np.int64), empty_splats(scene.sh_degree)
    return TrainedFrame(rows, empty, rows, empty)


def _replay(
    context: Context, before: Scene, scene: Scene, plan: FramePlan, packet: Packet
) -> tuple[FramePlan, TrainedFrame | None]:
    """What an earlier encode did with the frame, as its packet states: the plan, and what was trained."""
    # Those that a cross-fade changes are not among those that the masks select.
    changed = changed_between(before.state, scene.state)
    is_trained = bool(plan.effects) or bool(changed.any())
    # A deferred frame's changes are still to be trained. With a time budget, a skip in place of changes signals it.
    deferred = is_trained and context.settings.time_budget is not None and packet.kind == PacketKind.SKIP
    plan = replace(plan, deferred=deferred)
    if not is_trained or deferred:
        return plan, None
    rows = np.flatnonzero(plan.selection.selected | changed)
    if not context.method.dense:
        context.views.of(before.splats).detach(rows)
    return plan, replace(_no_change(before.splats), kept=rows)
