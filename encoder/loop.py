"""The closed loop: every frame is trained from what the decoder has of the frame before it.

A later frame is compensated, what changed in it is detected, it is trained, coded, and reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from decogs.codec.lattice import Lattice, default_lattice, dequantise
from decogs.codec.state import State
from decogs.formats.callbacks import OnWarning
from decogs.formats.container import Packet
from decogs.formats.errors import RigError, StreamError, TrainingError
from decogs.formats.splats import empty_splats, sh_degree_of

from .change.detection import Change
from .closed_segments import NextSegment, catch_up
from .coding.coded_scene import Written
from .coding.time_control import TimeControl
from .input.imported_keyframe import KeyframeSource
from .input.imported_splats import SplatSource
from .input.ingest import Ingest, RigFrame
from .input.recordings import difference, recorded_in
from .output.convergence_log import ConvergenceLog
from .output.frame_report import FrameReporter
from .output.reports import FrameReport, OnKeyframeStep
from .output.resume import Interrupted
from .output.stream_output import StreamOutput
from .replay import replay, splats_taken_over, take_over
from .settings.encode import EncodeSettings
from .stopwatch import Stopwatch
from .stream_state import CodedFrame, FrameInWork, FramePlan, StreamState
from .training.cross_fade import CrossFade, go_over, with_exact_changes
from .training.first_frame import train_first_frame
from .training.keyframe import scene_extent
from .training.method import FrameInput, TrainedFrame
from .training.schedule import StoppingRule
from .training.splat_keyframe import import_splats


def _detected(state: StreamState, frame: RigFrame, watch: Stopwatch) -> tuple[FrameInWork, bool]:
    """A frame, compensated, and what changed in it; whether the scene is that before a flash again."""
    index, frame = frame.index - state.scene.header.first_frame, state.compensation.matched(frame)
    restarted = state.restart(index, watch)
    compensated, corrections = state.compensation.find(frame, state.scene.splats, state.views, watch)
    returned = state.return_from_flash(compensated, watch)
    return state.detect(frame, compensated, corrections, watch, restarted=restarted), returned


class StreamEncoder:
    """Encodes frames one after the other into an open stream; ``keyframe`` is one to begin with, untrained.

    ``keyframe`` may be a file of Gaussians, which is made one. ``convergence`` takes the loss of every step of
    training, ``on_warning`` what the user should know at once.
    """

    def __init__(
        self,
        ingest: Ingest,
        settings: EncodeSettings,
        output: StreamOutput,
        *,
        seed: int,
        threads: int,
        keyframe: KeyframeSource | SplatSource | None = None,
        device: str = "auto",
        convergence: ConvergenceLog | None = None,
        on_warning: OnWarning | None = None,
    ) -> None:
        self._settings, self._convergence, self._on_warning = settings, convergence, on_warning
        self._splats = keyframe if isinstance(keyframe, SplatSource) else None
        source = keyframe if isinstance(keyframe, KeyframeSource) else None
        self._state = StreamState(ingest, settings, output, source, seed=seed, threads=threads, device=device)
        self._reporter = FrameReporter(ingest, self._state.kernel, self._state.views, on_warning, threads=threads)
        self._time = None if settings.time_budget is None else TimeControl(settings.time_budget)
        self._next: NextSegment | None = None

    def check_header(self, first: int) -> None:
        """Raises RigError, before anything is trained, for a rig that no stream's header can hold."""
        try:
            self._state.new_scene(first, default_lattice(1.0), self._settings.keyframe.sh_degree).header.to_bytes()
        except StreamError as error:
            problem = str(error).partition(" in packet ")[0].removeprefix("header: ")
            path = self._state.ingest.rig.path
            raise RigError(f"{path}: a stream cannot hold this rig ({problem}); change its calibration") from None

    def encode_key(self, frame: RigFrame, on_step: OnKeyframeStep | None) -> FrameReport:
        """Trains or takes over the first frame and writes header and keyframe; the output begins only then."""
        watch, state = self._begin(frame), self._state
        state.recorded = frame.recorded
        key, lattice = self._first_frame(frame, watch, on_step)
        state.scene = state.new_scene(frame.index, lattice, sh_degree_of(key.coefficients))
        splats, frame = dequantise(key, lattice), state.compensation.matched(frame)
        state.compensation.see(splats)
        frame, corrections = state.compensation.find(frame, splats, state.views, watch)
        state.compensation.begin(corrections)
        with watch.stage("write"):
            written = state.scene.begin(key, corrections)
        state.begin(frame, watch)
        if state.source is not None:
            self._check_source(state.source, frame, watch)
        return self._report(frame, written, Change([], np.ones(len(key), bool)), watch)

    def encode_next(
        self, frame: RigFrame, on_step: OnKeyframeStep | None = None, following: Sequence[RigFrame] = ()
    ) -> FrameReport:
        """Compensates, detects, trains, codes and reports the next frame.

        ``on_step`` follows the training of a new keyframe, where the frame shows another scene. ``following``: those
        up to the start of the closed segment that the frame goes over to.
        """
        watch, state = self._begin(frame), self._state
        ahead = self._next_segment([frame, *following], watch)
        now, returned = _detected(state, frame, watch)
        if now.change.cut:
            key = self._keyframe_of_cut(now, on_step)
            if key is not None:
                return self._write_cut(now, key)
            now = state.not_cut(now)
        done = None if ahead is None else ahead.coded(now.recorded.index)
        if done is None:
            fade = None if ahead is None else ahead.fade(now.recorded.index, state)
            done = self._code(state, now, returned=returned, fade=fade)
        else:
            done = state.repeat(now, done)
        if self._time is not None:
            self._time.took(watch.seconds, held=done.held)
        report = self._report(now.compensated, done.written, done.change, watch)
        return replace(report, effects=list(done.effects), rejected=done.rejected, uncorrected=done.uncorrected)

    def _next_segment(self, frames: Sequence[RigFrame], watch: Stopwatch) -> NextSegment | None:
        """The segment that begins with the last of ``frames``, if it was trained for those that go over to it."""
        start = frames[-1].index
        if len(frames) > 1 and not self._state.method.dense and (self._next is None or self._next.start != start):
            unlogged = copy(self)
            unlogged._convergence = None
            with watch.stage("next segment"):
                self._next = NextSegment(self._state, frames, unlogged._follow)
        return self._next if self._next is not None and self._next.start == start else None

    def _follow(self, state: StreamState, frame: RigFrame) -> CodedFrame | None:
        """Trains a frame of the next segment; None if it does not show the same scene as the first keyframe."""
        now, returned = _detected(state, frame, Stopwatch())
        return None if now.change.cut else self._code(state, now, returned=returned)

    def _code(
        self, state: StreamState, now: FrameInWork, *, returned: bool, fade: CrossFade | None = None
    ) -> CodedFrame:
        """Trains a frame, codes it, and hands on what later ones need."""
        watch, index = now.watch, now.compensated.index - state.scene.header.first_frame
        plan = state.plan(now)
        held = bool(plan.effects) and self._is_held(state, watch)
        trained = self._trained_now(state, now, index, plan) if plan.effects and not held else None
        if fade is not None:
            plan = replace(plan, settings=with_exact_changes(plan.settings))
            trained = self._gone_over(state, now, index, plan, trained, fade)
        with watch.stage("write"):
            written = state.scene.code(index, trained, plan.settings.significance, now.corrections, whole=returned)
        if state.rate is not None:
            state.rate.wrote(written.packet.kind, written.packet.size)
        effects = () if held else plan.effects
        kept, hurried = (None, False) if trained is None else (trained.kept, trained.hurried)
        uncorrected = state.commit(now, kept, effects, held=held, hurried=hurried)
        rejected = trained is not None and trained.rejected
        return CodedFrame(written, now.change, effects, uncorrected, held=held, rejected=rejected)

    def _keyframe_of_cut(self, now: FrameInWork, on_step: OnKeyframeStep | None) -> State | None:
        """Trains a keyframe of another scene, for the stream's header and with later ids; None where that fails."""
        state = self._state
        state.forget()
        try:
            key, _ = train_first_frame(
                state.kernel,
                state.ingest,
                now.recorded,
                self._settings,
                now.watch,
                seed=state.seed,
                threads=state.threads,
                compensation=state.compensation,
                stopping=self._stopping(),
                on_step=on_step,
                header=state.scene.header,
                first_id=state.scene.state.next_id,
            )
        except TrainingError:
            # Such as pictures in which no points are found: the frame is trained as others are.
            state.show_again(now.watch)
            return None
        return key

    def _write_cut(self, now: FrameInWork, key: State) -> FrameReport:
        state, watch = self._state, now.watch
        splats = dequantise(key, state.scene.header.lattice)
        state.compensation.see(splats)
        frame, corrections = state.compensation.find(now.recorded, splats, state.views, watch)
        state.compensation.begin(corrections)
        with watch.stage("write"):
            written = state.scene.begin_anew(key, corrections)
        state.start_anew(frame, watch)
        return self._report(frame, written, replace(now.change, selected=np.ones(len(key), bool)), watch)

    def take_over(self, left: Interrupted, span: range) -> None:
        """Goes on from what an earlier encode left; raises UsageError unless it is the beginning of this one."""
        if self._splats is not None:
            # Rotation and lattice were found from pictures; the digest in the header identifies the file.
            self._state.source = splats_taken_over(self._splats, left)
        take_over(self._state, left, span)

    def replay(self, frame: RigFrame, packet: Packet, origin: str = "") -> FrameReport:
        """Does all that encoding the frame did but for the training: the result is in the packet.

        ``origin``: where the packet comes from, for a frame that is compared with its pictures; "" for none.
        """
        watch = Stopwatch()
        replayed = replay(self._state, frame, packet, watch)
        if origin:
            masks = replayed.change.masks
            self._reporter.check_footage(replayed.frame, self._state.scene.splats, origin, masks, watch)
        report = self._report(replayed.frame, replayed.written, replayed.change, watch)
        return replace(report, replayed=True, overlooked=False, uncorrected=replayed.uncorrected)

    def _check_source(self, source: KeyframeSource, frame: RigFrame, watch: Stopwatch) -> None:
        """Warns where an earlier stream's keyframe is of other footage."""
        if not recorded_in(source.header):
            self._reporter.check_footage(frame, self._state.scene.splats, f"`keyframe` {source.path}", [], watch)
        elif (problem := difference(source.header, frame.recorded)) and self._on_warning is not None:
            self._on_warning(f"`keyframe` {source.path}: it was made from {problem}; is it of other footage?")

    def _begin(self, frame: RigFrame) -> Stopwatch:
        if self._convergence is not None:
            self._convergence.begin(frame.index)
        return Stopwatch()

    def _stopping(self, deadline: float | None = None) -> StoppingRule:
        on_loss = None if self._convergence is None else self._convergence.step
        return StoppingRule(deadline, self._settings.target_psnr, on_loss)

    def _first_frame(self, frame: RigFrame, watch: Stopwatch, on_step: OnKeyframeStep | None) -> tuple[State, Lattice]:
        state = self._state
        if self._splats is not None:
            with watch.stage("import"):
                imported = import_splats(state.kernel, state.ingest, frame, self._settings, self._splats)
            state.source = imported.source
            if self._on_warning is not None:
                for text in imported.warnings:
                    self._on_warning(text)
        if state.source is not None:
            state.source.check(state.ingest, frame.index)
            state.ingest.set_near_planes(state.source.header.near_planes)
            state.compensation.colours = state.source.header.camera_colours
            return state.source.state, state.source.header.lattice
        return train_first_frame(
            state.kernel,
            state.ingest,
            frame,
            self._settings,
            watch,
            seed=state.seed,
            threads=state.threads,
            compensation=state.compensation,
            stopping=self._stopping(),
            on_step=on_step,
        )

    def _is_held(self, state: StreamState, watch: Stopwatch) -> bool:
        """Whether a frame that needs training gets none, so that a later one has enough time."""
        return self._time is not None and self._time.holds(watch.seconds, state.trainer.min_seconds)

    def _trained_now(self, state: StreamState, now: FrameInWork, index: int, plan: FramePlan) -> TrainedFrame:
        if not now.restarted:
            return self._trained(state, now, index, plan)
        plan = replace(plan, lit=None)  # Every round selects again.
        return catch_up(state, now, plan.settings, lambda now: self._trained(state, now, index, plan))

    def _gone_over(
        self,
        state: StreamState,
        now: FrameInWork,
        index: int,
        plan: FramePlan,
        trained: TrainedFrame | None,
        fade: CrossFade,
    ) -> TrainedFrame:
        """The frame, trained or not, gone over to what the next segment shows."""
        scene, none = state.scene.splats, np.zeros(0, np.int64)
        with now.watch.stage("training"):
            state.views.detach(fade.rows)
            return go_over(
                state.kernel,
                scene,
                trained or TrainedFrame(none, empty_splats(scene.sh_degree), none, empty_splats(scene.sh_degree)),
                fade,
                plan.settings,
                extent=scene_extent(state.ingest.views) or 1.0,
                seed=(state.seed, index),
                on_loss=self._stopping().on_loss,
            )

    def _trained(self, state: StreamState, now: FrameInWork, index: int, plan: FramePlan) -> TrainedFrame:
        deadline = None if self._time is None else self._time.deadline(now.watch.seconds)
        given = FrameInput(
            index,
            state.scene.splats,
            now.change.selected,
            plan.lit,
            now.compensated.training,
            now.change.masks,
            state.motion.expected(),
            plan.settings,
            self._stopping(deadline),
        )
        with now.watch.stage("training"):
            state.views.detach(np.flatnonzero(given.selected))
            return state.trainer.train(given)

    def _report(self, frame: RigFrame, written: Written, change: Change, watch: Stopwatch) -> FrameReport:
        scene = self._state.scene
        return self._reporter.report(frame, scene.header, scene.splats, written.packet, written.costs, change, watch)
