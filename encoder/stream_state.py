"""What an encode carries from frame to frame: the coded scene, the views of it, masks, motion and compensation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.corrections import Corrections
from decogs.codec.lattice import Lattice
from decogs.codec.state import State, same_values

from .analysis.enabled import enabled_effects
from .backends import IncrementalViews, training_kernel
from .change.detection import Change, ChangeDetector
from .coding.coded_scene import CodedScene, Written
from .coding.rate_control import RATE_CONTROLS, RateControl
from .coding.stream_header import stream_header
from .input.compensation.stream import Compensation
from .input.imported_keyframe import KeyframeSource
from .input.ingest import Ingest, RigFrame
from .output.stream_output import StreamOutput
from .settings.encode import EncodeSettings
from .settings.frame import FrameSettings
from .stopwatch import Stopwatch
from .training.cross_fade import fade_cameras
from .training.method import FrameTrainer, TrainedFrame, training_context
from .training.methods import FRAME_METHODS
from .training.warm_start import Motion


@dataclass(frozen=True)
class FrameInWork:
    """A later frame: as recorded, compensated, and what changed in it since the state ``before``.

    ``restarted``: that is the first keyframe's, since the frame begins a closed segment.
    """

    recorded: RigFrame
    compensated: RigFrame
    corrections: Corrections
    change: Change
    before: State
    watch: Stopwatch
    restarted: bool = False


@dataclass(frozen=True)
class CodedFrame:
    """A later frame that was written: what changed in it, the ``effects`` it was trained for, what it came to.

    ``uncorrected``: corrections that ended with it. ``held``: its training waits for time. ``rejected``: it made the
    pictures worse, and changed nothing.
    """

    written: Written
    change: Change
    effects: tuple[str, ...]
    uncorrected: list[str]
    held: bool
    rejected: bool


@dataclass(frozen=True)
class FramePlan:
    """What a frame calls for: its effects by name, none where nothing is selected, and how it is trained for them.

    ``lit`` (N,): the selected Gaussians that light alone changes, in a frame in which others move; None otherwise.
    """

    effects: tuple[str, ...]
    settings: FrameSettings
    lit: NDArray[np.bool_] | None


class StreamState:
    """The state of one encode; ``scene``, ``changes`` and ``trainer`` are there once it has its first frame.

    ``source``: an earlier stream's keyframe to begin with, or None. ``views`` show the scene, and are none for a dense
    method. ``recorded``: digests of the first frame's pictures by camera, for the header. ``rate`` keeps to a budget of
    bytes, if there is one.
    """

    scene: CodedScene
    changes: ChangeDetector
    trainer: FrameTrainer

    def __init__(
        self,
        ingest: Ingest,
        settings: EncodeSettings,
        output: StreamOutput,
        source: KeyframeSource | None,
        *,
        seed: int,
        threads: int,
        device: str,
    ) -> None:
        self.ingest, self.settings, self.source, self._output = ingest, settings, source, output
        self.seed, self.threads = seed, threads
        self.method = FRAME_METHODS.get(settings.method)
        self.kernel = training_kernel(device, threads)
        self.compensation = Compensation(ingest, self.kernel, settings.corrections)
        self.views = IncrementalViews([])
        self.motion = Motion()
        self.rate = self._new_rate()
        self.recorded: Mapping[str, str] = {}
        self._first_frame: RigFrame | None = None
        self._fade_views = IncrementalViews([])

    def new_scene(self, first: int, lattice: Lattice, sh_degree: int) -> CodedScene:
        """The scene of a stream that begins with the rig's frame ``first``, before its keyframe."""
        header = stream_header(
            self.ingest,
            self.settings,
            first=first,
            lattice=lattice,
            sh_degree=sh_degree,
            seed=self.seed,
            corrected=self.compensation.cameras,
            colours=self.compensation.colours,
            inherited=None if self.source is None else self.source.settings,
            recorded=self.recorded,
        )
        return CodedScene(header, self._output, level=self.settings.zstd_level, segment=self.settings.segment)

    def begin(self, frame: RigFrame, watch: Stopwatch) -> None:
        """Takes the first frame, compensated, whose state stands."""
        self._first_frame = frame if self.settings.closed else None
        self._start(frame, watch)

    def forget(self) -> None:
        """Frees what shows the scene so far, before another one is trained; `start_anew` makes it again."""
        self.views.views.clear()

    def not_cut(self, now: FrameInWork) -> FrameInWork:
        """A frame that shows another scene but cannot be a keyframe, as any other frame."""
        change = self.changes.select_again(replace(now.change, cut=False), len(now.before))
        return replace(now, change=change)

    def show_again(self, watch: Stopwatch) -> None:
        """Shows the scene that stands after all, where no other one could be trained."""
        with watch.stage("commit"):
            self.views.views.extend(self.kernel.fixed_view(view.pinhole) for view in self.ingest.views)
            self.views.show(self.scene.splats)

    def start_anew(self, frame: RigFrame, watch: Stopwatch) -> None:
        """Takes a frame, compensated, whose state stands: nothing is left of what the frames before handed on."""
        self.compensation.restart()
        self.rate = self._new_rate()
        self._start(frame, watch)

    def _start(self, frame: RigFrame, watch: Stopwatch) -> None:
        """Makes anew what one frame hands to the next, for the scene that stands."""
        scene, views = self.scene.splats, self.ingest.views
        with watch.stage("commit"):
            if not self.method.dense:
                # Where a closed segment starts they are there, and keep their memory.
                if not self.views.views:
                    self.views.views.extend(self.kernel.fixed_view(view.pinhole) for view in views)
                self.views.show(scene)
            self.trainer = self.method.trainer(
                training_context(
                    self.kernel, views, self.views.views, self.settings, scene, seed=self.seed, threads=self.threads
                )
            )
        self.changes = ChangeDetector(frame.training, self.views.views, self.settings, threads=self.threads)
        self.motion.begin(len(scene))

    def restart(self, index: int, watch: Stopwatch) -> bool:
        """Goes back to the first frame if frame ``index`` of the stream begins a closed segment; whether it does.

        Nothing is left of the frames before ``index``: everything that one frame hands to the next is made anew.
        """
        if self._first_frame is None or index % self.settings.segment:
            return False
        self.scene.restart(index)
        self.start_anew(self._first_frame, watch)
        return True

    def apart(self) -> StreamState:
        """A state that begins with the next closed segment and writes nothing.

        It shows its scene in the views of this one, whose own scene must be shown again afterwards.
        """
        other = copy(self)
        other.scene, other.compensation = self.scene.unwritten(), self.compensation.apart()
        other.motion = Motion()
        return other

    def repeat(self, now: FrameInWork, coded: CodedFrame) -> CodedFrame:
        """Writes a segment's first frame as a state `apart` from this one has coded it."""
        packet = coded.written.packet
        with now.watch.stage("write"):
            self.scene.repeat(packet)
        if self.rate is not None:
            self.rate.wrote(packet.kind, packet.size)
        uncorrected = self.commit(now, np.zeros(0, np.int64), coded.effects)
        return replace(coded, change=now.change, uncorrected=uncorrected)

    def fade_views(self) -> IncrementalViews:
        """Views in which two closed segments are compared; they show what they were last made to show."""
        if not self._fade_views.views:
            cameras = fade_cameras([view.pinhole for view in self.ingest.views])
            self._fade_views.views.extend(self.kernel.fixed_view(camera) for camera in cameras)
        return self._fade_views

    def rehearse(self, now: FrameInWork, trained: TrainedFrame, settings: FrameSettings) -> FrameInWork:
        """Takes a round of training of the frame, unwritten; the frame for another round."""
        before = self.scene.state
        with now.watch.stage("commit"):
            self.scene.rehearse(trained, settings.significance)
            self.views.update(self.scene.splats, trained.kept, before.ids, self.scene.state.ids)
        self.motion.begin(len(self.scene.state))
        with now.watch.stage("selection"):
            change = self.changes.select_again(now.change, len(self.scene.state))
        return replace(now, change=change)

    def _new_rate(self) -> RateControl | None:
        budget = self.settings.frame_budget
        if budget is None:
            return None
        return RATE_CONTROLS.get(self.settings.rate_control)(budget, self.settings.segment)

    def return_from_flash(self, frame: RigFrame, watch: Stopwatch) -> bool:
        """Goes back to the scene before a flash if the pictures do; the decoder's state is then another."""
        with watch.stage("masks"):
            kept = self.changes.flash_is_over(frame.index, frame.training)
        if kept is None:
            return False
        self.scene.go_back(kept.state)
        self.motion.last = kept.motion
        with watch.stage("commit"):
            self.views.show(self.scene.splats)
        return True

    def detect(
        self,
        recorded: RigFrame,
        compensated: RigFrame,
        corrections: Corrections,
        watch: Stopwatch,
        *,
        restarted: bool = False,
    ) -> FrameInWork:
        """What changed in a frame."""
        before = self.scene.state
        change = self.changes.detect(compensated.index, compensated.training, before, self.motion.last, watch)
        return FrameInWork(recorded, compensated, corrections, change, before, watch, restarted)

    def plan(self, now: FrameInWork) -> FramePlan:
        """What a frame calls for."""
        settings, lit = self.settings, None
        effects = settings.frame_effects if now.change.selected.any() else ()
        if effects and settings.detect_per_frame:
            with now.watch.stage("effects"):
                found = enabled_effects(
                    settings,
                    now.compensated.training,
                    self.changes.references,
                    now.change.masks,
                    threads=self.threads,
                )
                effects, settings = found.effects, found.settings
                if found.moving is not None:
                    lit = self.changes.lit(now.change, found.moving)
        significance = settings.frame.significance
        if self.rate is not None:
            significance = self.rate.significance(significance)
        return FramePlan(effects, replace(settings.frame, significance=significance), lit)

    def commit(
        self,
        now: FrameInWork,
        trained: NDArray[np.int64] | None,
        effects: Sequence[str],
        *,
        held: bool = False,
        hurried: bool = False,
    ) -> list[str]:
        """Takes what later frames need to know of this one, whose state stands; returns what compensation is ended.

        ``trained``: rows that were, or None. ``effects``: those that were enabled. ``held``: it waits for time; what
        moves is taken to move on. ``hurried``: what the scene now clearly misses is still to be done.
        """
        scene, pictures, masks = self.scene, now.compensated.training, now.change.masks
        if trained is not None:
            with now.watch.stage("commit"):
                if now.restarted:
                    self.views.show(scene.splats)
                else:
                    self.views.update(scene.splats, trained, now.before.ids, scene.state.ids)
            # Training that was rejected, or whose changes were all reverted, has made up for nothing.
            if masks and not same_values(now.before, scene.state):
                self.changes.trained(pictures, masks, moved="motion" in effects, hurried=hurried)
        self.changes.passed(pictures, held=held)
        if now.restarted:
            # What has moved since the first frame is no velocity.
            self.motion.begin(len(scene.state))
        elif held:
            self.motion.hold()
        else:
            self.motion.moved(scene.displacements(now.before))
        changed = [mask.dilated for mask in masks]
        return self.compensation.judge(now.recorded.training, now.corrections, changed, self.views, now.watch)
