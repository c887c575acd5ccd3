"""The closed loop: every frame is trained from what the decoder has of the frame before it.

A later frame is compensated, what changed in it is detected, it is trained, coded, and reported.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.codec.lattice import Lattice, default_lattice, dequantise
from decogs.codec.state import State
from decogs.formats.callbacks import OnWarning
from decogs.formats.container import Packet
from decogs.formats.errors import RigError, StreamError, TrainingError
from decogs.formats.splats import sh_degree_of

from .change.detection import Change
from .closed_segments import catch_up
from .coding.coded_scene import Written
from .coding.time_control import TimeControl
from .input.imported_keyframe import KeyframeSource
from .input.imported_splats import SplatSource
from .input.ingest import Ingest, RigFrame
from .output.convergence_log import ConvergenceLog
from .output.frame_report import FrameReporter
from .output.reports import FrameReport, OnKeyframeStep
from .output.resume import Interrupted
from .output.stream_output import StreamOutput
from .replay import replay, splats_taken_over, take_over
from .settings.encode import EncodeSettings
from .stopwatch import Stopwatch
from .stream_state import FrameInWork, FramePlan, StreamState
from .training.first_frame import train_first_frame
from .training.method import FrameInput, TrainedFrame
from .training.schedule import StoppingRule
from .training.splat_keyframe import import_splats


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
            self._reporter.check_footage(frame, state.scene.splats, f"`keyframe` {state.source.path}", [], watch)
        return self._report(frame, written, Change([], np.ones(len(key), bool)), watch)

    def encode_next(self, frame: RigFrame, on_step: OnKeyframeStep | None = None) -> FrameReport:
        """Compensates, detects, trains, codes and reports the next frame.

        ``on_step`` follows the training of a new keyframe, where the frame shows another scene.
        """
        watch, state = self._begin(frame), self._state
        index, frame = frame.index - state.scene.header.first_frame, state.compensation.matched(frame)
        restarted = state.restart(index, watch)
        compensated, corrections = state.compensation.find(frame, state.scene.splats, state.views, watch)
        returned = state.return_from_flash(compensated, watch)
        now = state.detect(frame, compensated, corrections, watch, restarted=restarted)
        if now.change.cut:
            key = self._keyframe_of_cut(now, on_step)
            if key is not None:
                return self._write_cut(now, key)
            now = state.not_cut(now)
        plan = state.plan(now)
        effects = plan.effects
        held = bool(effects) and self._is_held(watch)
        trained = self._trained_now(now, index, plan) if effects and not held else None
        with watch.stage("write"):
            written = state.scene.code(index, trained, plan.settings.significance, corrections, whole=returned)
        if state.rate is not None:
            state.rate.wrote(written.packet.kind, written.packet.size)
        effects = () if held else effects
        kept, hurried = (None, False) if trained is None else (trained.kept, trained.hurried)
        uncorrected = state.commit(now, kept, effects, held=held, hurried=hurried)
        if self._time is not None:
            self._time.took(watch.seconds, held=held)
        report = self._report(compensated, written, now.change, watch)
        rejected = trained is not None and trained.rejected
        return replace(report, effects=list(effects), rejected=rejected, uncorrected=uncorrected)

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

    def _is_held(self, watch: Stopwatch) -> bool:
        """Whether a frame that needs training gets none, so that a later one has enough time."""
        return self._time is not None and self._time.holds(watch.seconds, self._state.trainer.min_seconds)

    def _trained_now(self, now: FrameInWork, index: int, plan: FramePlan) -> TrainedFrame:
        if not now.restarted:
            return self._trained(now, index, plan)
        plan = replace(plan, lit=None)  # Every round selects again.
        return catch_up(self._state, now, plan.settings, lambda now: self._trained(now, index, plan))

    def _trained(self, now: FrameInWork, index: int, plan: FramePlan) -> TrainedFrame:
        deadline = None if self._time is None else self._time.deadline(now.watch.seconds)
        given = FrameInput(
            index,
            self._state.scene.splats,
            now.change.selected,
            plan.lit,
            now.compensated.training,
            now.change.masks,
            self._state.motion.expected(),
            plan.settings,
            self._stopping(deadline),
        )
        with now.watch.stage("training"):
            self._state.views.detach(np.flatnonzero(given.selected))
            return self._state.trainer.train(given)

    def _report(self, frame: RigFrame, written: Written, change: Change, watch: Stopwatch) -> FrameReport:
        scene = self._state.scene.splats
        return self._reporter.report(frame, scene, written.packet, written.costs, change, watch)
