"""The closed loop: every frame is trained from what the decoder has of the frame before it.

Chosen: the encoder writes a packet, reconstructs the state from those very bytes, and trains the next frame from it,
so that quantisation errors cannot add up. A frame that an earlier encode has written already is replayed: all that
encoding it does but for the training (`resuming`). Rejected: training on the encoder's own floats and quantising
afterwards (drifts: the error of frame t is never seen again).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from decogs.codec.corrections import CorrectedCameras, Corrections, split_corrections, write_corrections
from decogs.codec.deltas import Delta, apply_delta, difference
from decogs.codec.digest import digest
from decogs.codec.header import StreamHeader
from decogs.codec.lattice import Lattice, default_lattice, dequantise, quantise
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import ARRAYS, State, take_rows
from decogs.codec.syntax import Coded, payload_costs, write_delta, write_key, write_skip
from decogs.decoder.lens import is_distorted
from decogs.formats.container import Packet, PacketKind
from decogs.formats.errors import DecogsError, RigError, StreamError
from decogs.formats.rigs import Rig
from decogs.formats.splats import FloatArray, Splats, sh_degree_of

from .analysis import frame_effects, leave_out
from .change.flashes import BeforeFlash, may_be_flash
from .change.masks import FrameMask, MaskMemory, showing
from .change.selection import select, view_evidence
from .coding.rate_control import RateControl
from .coding.requantise import coarse_changes
from .coding.time_control import TimeControl
from .input.compensation import corrector_of
from .input.imported_keyframe import KeyframeSource
from .input.ingest import Ingest, RigFrame
from .output.convergence_log import AnytimeLog
from .output.footage import strange_cameras, warning_of
from .output.reports import EncodeReport, FrameReport, OnFrame, OnKeyframeStep, OnWarning, Stopwatch
from .output.resume import Interrupted, check_resumable
from .output.stream_output import FileOutput, StreamOutput, open_output
from .rasterise import FixedView, fixed_view, training_kernel
from .settings.effects import FRAME_EFFECTS
from .settings.encode import EncodeSettings
from .settings.frame import EconomySettings, FrameSettings, SelectionSettings
from .training.delta import FrameTrainer, TrainedFrame
from .training.first_frame import train_first_frame
from .training.keyframe import mean_picture_psnr, mean_psnr, scene_extent
from .training.schedule import Effort
from .training.threedgstream import BaselineTrainer

MOST_GROWTH = 1.25
"""How much larger than the keyframe's the scene may become by clones and splits. Long streams would grow without end:
thousand frames of the tests' scene from 2 500 Gaussians to 18 000, and lose 2 dB by it."""


class StreamEncoder:
    """Encodes frames one after the other into an open stream; ``keyframe`` is one to begin with, untrained.

    ``anytime`` takes the loss of every step of training, ``on_warning`` what the user should know at once.
    """

    def __init__(
        self,
        ingest: Ingest,
        settings: EncodeSettings,
        output: StreamOutput,
        *,
        seed: int,
        threads: int,
        keyframe: KeyframeSource | None = None,
        device: str = "auto",
        anytime: AnytimeLog | None = None,
        on_warning: OnWarning | None = None,
    ) -> None:
        self._on_warning = on_warning or (lambda text: None)
        self._ingest, self._settings, self._seed, self._threads = ingest, settings, seed, threads
        self._output, self._source, self._anytime = output, keyframe, anytime
        self._kernel = training_kernel(device, threads)
        self._corrector = corrector_of(ingest.views, settings.corrections)
        self._watch: list[FixedView] = []
        self._state: State | None = None
        self._first_state: State | None = None
        self._motion: FloatArray = np.zeros((0, 3), np.float32)
        self._held = 0
        self._overlooked = False
        self._before_flash: BeforeFlash | None = None
        budget = settings.frame_budget
        self._rate = None if budget is None else RateControl(budget, settings.segment)
        self._time = None if settings.time_budget is None else TimeControl(settings.time_budget)

    def encode_key(self, frame: RigFrame, on_step: OnKeyframeStep | None) -> FrameReport:
        """Trains or takes over the first frame and writes header and keyframe; the output begins only then."""
        watch = self._begin(frame)
        if self._source is None:
            state, lattice = train_first_frame(
                self._kernel,
                self._ingest,
                frame,
                self._settings,
                watch,
                seed=self._seed,
                threads=self._threads,
                corrector=self._corrector,
                effort=self._effort(),
                on_step=on_step,
            )
        else:
            self._source.check(self._ingest, frame.index)
            self._ingest.set_near_planes(self._source.header.near_planes)
            state, lattice = self._source.state, self._source.header.lattice
        self._header = self._stream_header(frame.index, lattice, sh_degree_of(state.coefficients))
        self._see_surface(dequantise(state, lattice))
        frame, corrections = self._corrected(frame, dequantise(state, lattice), watch)
        self._begin_corrections(corrections)
        with watch.stage("write"):
            self._output.begin(self._header.to_bytes())
            coded = self._with_corrections(write_key(state, level=self._settings.zstd_level), corrections)
            packet = self._commit(PacketKind.KEY, 0, coded)
        self._settle_key(frame, watch)
        if self._source is not None:
            with watch.stage("measure"):
                self._check_footage(frame, f"--keyframe {self._source.path}", [])
        return self._report(frame, packet, coded.costs, 1.0, watch, [])

    def check_header(self, first: int) -> None:
        """Raises RigError, before anything is trained, for a rig that no stream's header can hold."""
        try:
            self._stream_header(first, default_lattice(1.0), self._settings.keyframe.sh_degree).to_bytes()
        except StreamError as error:
            problem = str(error).partition(" in packet ")[0].removeprefix("header: ")
            raise RigError(
                f"{self._ingest.rig.path}: a stream cannot hold this rig ({problem}); change its calibration"
            ) from None

    def take_over(self, left: Interrupted, span: range) -> None:
        """Goes on from what an earlier encode left; raises UsageError unless it is the beginning of this one."""
        first, header = span.start, left.header
        if self._source is not None:
            self._source.check(self._ingest, first)
            header = self._source.header
        near = header.near_planes
        self._ingest.set_near_planes({camera.name: near.get(camera.name, 0.0) for camera in self._ingest.rig.cameras})
        self._header = self._stream_header(first, header.lattice, header.sh_degree)
        left.check(self._header, len(span))
        if self._source is not None:
            key = reconstruct(None, next(left.packets()), self._header)
            left.check_keyframe(same=digest(key) == digest(self._source.state))

    def replay(self, frame: RigFrame, packet: Packet, origin: str = "") -> FrameReport:
        """Does all that encoding the frame did but for the training: the result is in the packet.

        ``origin``: where the packet comes from, for a frame that is compared with its pictures; "" for none.
        """
        watch, share = Stopwatch(), 1.0
        masks: Sequence[FrameMask] = []
        corrections, body = split_corrections(packet, self._header.corrected)
        recorded, uncorrected = frame.training, list[str]()
        if self._corrector is not None:
            frame = replace(frame, training=self._corrector.undo(recorded, corrections))
        if self._state is None:
            self._advance(packet)
            self._see_surface(self._scene)
            self._begin_corrections(corrections)
            self._settle_key(frame, watch)
        else:
            self._return_from_flash(frame, watch)
            before = self._state
            masks, selected = self._changes(frame, len(before), watch)
            effects, _ = self._called_for(frame, masks, selected, watch)
            trained = np.flatnonzero(selected) if effects else None
            # What was held is still to be done. With a time budget, a packet of nothing is all that tells.
            held = trained is not None and self._time is not None and packet.kind == PacketKind.SKIP
            if held:
                trained, effects = None, ()
            if trained is not None:
                for view in self._watch:
                    view.lift(trained)
            self._advance(packet)
            self._go_on(frame, before, masks, trained, effects, watch, held=held)
            uncorrected = self._judge(recorded, corrections, masks, watch)
            share = _share(selected)
        if origin:
            with watch.stage("measure"):
                self._check_footage(frame, origin, masks)
        costs = payload_costs(body, self._header.coefficients)
        report = self._report(frame, packet, costs, share, watch, masks)
        return replace(report, replayed=True, uncorrected=uncorrected)

    def encode_next(self, frame: RigFrame) -> FrameReport:
        """Trains and writes the next frame from the reconstructed state of the one before."""
        assert self._state is not None
        watch, index = self._begin(frame), frame.index - self._header.first_frame
        recorded = frame.training
        frame, corrections = self._corrected(frame, self._scene, watch)
        returned = self._return_from_flash(frame, watch)
        before = self._state
        masks, selected = self._changes(frame, len(before), watch)
        trained: TrainedFrame | None = None
        effects, settings = self._called_for(frame, masks, selected, watch)
        held = bool(effects) and self._is_held(watch)
        if effects and not held:
            with watch.stage("training"):
                trained = self._trainer.train(
                    self._scene,
                    selected,
                    frame.training,
                    masks,
                    self._motion * np.float32(1 + self._held),
                    frame=index,
                    settings=settings,
                    effort=self._effort(None if self._time is None else self._time.deadline(watch.seconds)),
                )
        with watch.stage("write"):
            delta = None if trained is None else self._delta(before, trained, settings.economy)
            kind, coded = self._coded(before, delta, index, whole=returned)
            coded = self._with_corrections(coded, corrections)
            packet = self._commit(kind, index, coded)
        if held:
            effects = ()
        hurried = trained is not None and trained.hurried
        kept = None if trained is None else trained.kept
        self._go_on(frame, before, masks, kept, effects, watch, held=held, hurried=hurried)
        uncorrected = self._judge(recorded, corrections, masks, watch)
        if self._time is not None:
            self._time.took(watch.seconds, held=held)
        report = self._report(frame, packet, coded.costs, _share(selected), watch, masks)
        return replace(
            report,
            effects=list(effects),
            given_up=trained is not None and trained.given_up,
            uncorrected=uncorrected,
            overlooked=self._overlooked,
        )

    def _is_held(self, watch: Stopwatch) -> bool:
        """Whether a frame that calls for training gets none, so that a later one has time enough."""
        if self._time is None or not isinstance(self._trainer, FrameTrainer):
            return False
        return self._time.holds(watch.seconds, self._trainer.least_seconds)

    def _called_for(
        self, frame: RigFrame, masks: Sequence[FrameMask], selected: NDArray[np.bool_], watch: Stopwatch
    ) -> tuple[tuple[str, ...], FrameSettings]:
        """The effects that a frame calls for, none where nothing is selected, and how it is trained for them."""
        settings = self._settings
        effects = tuple(name for name in FRAME_EFFECTS if name in settings.effects) if selected.any() else ()
        if effects and settings.ask_frames:
            with watch.stage("effects"):
                found = frame_effects(frame.training, self._masks.references, masks)
            # What moves changes its shading, too: without colours workbench_drift loses half a dB where things move.
            spared = [] if found.motion else [name for name in effects if not getattr(found, name)]
            settings = leave_out(settings, spared)
            effects = tuple(name for name in effects if name not in spared)
        economy = settings.frame.economy
        if self._rate is not None:
            economy = self._rate.economy(economy)
        return effects, replace(settings.frame, economy=economy)

    def _begin(self, frame: RigFrame) -> Stopwatch:
        if self._anytime is not None:
            self._anytime.begin(frame.index)
        return Stopwatch()

    def _effort(self, deadline: float | None = None) -> Effort:
        on_loss = None if self._anytime is None else self._anytime.step
        return Effort(deadline, self._settings.target_psnr, on_loss)

    def _see_surface(self, scene: Splats) -> None:
        """Shows the corrector the keyframe's scene, on which it compares cameras from then on."""
        if self._corrector is not None:
            views = self._ingest.views
            self._corrector.see(lambda number: self._kernel.forward(scene, views[number].pinhole, depth=True))

    def _begin_corrections(self, corrections: Corrections) -> None:
        if self._corrector is not None:
            self._corrector.begin(corrections)

    def _corrected(self, frame: RigFrame, scene: Splats, watch: Stopwatch) -> tuple[RigFrame, Corrections]:
        """The frame without its cameras' faults, against the ``scene`` before it, and what was taken out."""
        if self._corrector is None:
            return frame, {}

        def show(number: int) -> FloatArray:
            if self._watch:
                return self._watch[number].rgb
            return self._kernel.forward(scene, self._ingest.views[number].pinhole).rgb

        with watch.stage("corrections"):
            corrections = self._corrector.find(frame.training, show)
            return replace(frame, training=self._corrector.undo(frame.training, corrections)), corrections

    def _with_corrections(self, coded: Coded, corrections: Corrections) -> Coded:
        """The payload as the packet has it, the block of corrections before it if the stream has one."""
        if self._corrector is None:
            return coded
        block = write_corrections(corrections, self._header.corrected)
        return Coded(block + coded.payload, {**coded.costs, "corrections": len(block)})

    def _changes(
        self, frame: RigFrame, population: int, watch: Stopwatch
    ) -> tuple[Sequence[FrameMask], NDArray[np.bool_]]:
        """The frame's masks and S_t; the dense baseline looks at no mask and takes every Gaussian."""
        if self._settings.method == "3dgstream":
            return [], np.ones(population, bool)
        if not set(FRAME_EFFECTS) & set(self._settings.effects):
            return [], np.zeros(population, bool)
        shown = [view.rgb for view in self._watch]
        with watch.stage("masks"):
            masks = self._masks.masks(frame.training, shown)
        selected = np.zeros(population, bool)
        if any(mask.dilated.any() for mask in masks):
            if self._before_flash is None and may_be_flash(masks):
                assert self._state is not None
                self._before_flash = BeforeFlash(frame.index, self._state, self._motion, self._masks.copy())
            with watch.stage("selection"):
                selected = self._select(masks)
        self._overlooked = False
        if not selected.any() and (everything := self._masks.whole(frame.training, shown)):
            self._overlooked = True
            return everything, np.ones(population, bool)
        return masks, selected

    def _judge(
        self, recorded: Sequence[FloatArray], corrections: Corrections, masks: Sequence[FrameMask], watch: Stopwatch
    ) -> list[str]:
        """What the corrector will not correct any more, by what the frame's corrections gained."""
        if self._corrector is None or not masks:
            return []
        with watch.stage("corrections"):
            changed = [mask.dilated for mask in masks]
            return self._corrector.judge(recorded, corrections, lambda number: self._watch[number].rgb, changed)

    def _return_from_flash(self, frame: RigFrame, watch: Stopwatch) -> bool:
        """Goes back to the scene before a flash if the pictures do; the decoder then needs to be told all of it."""
        kept, now = self._before_flash, self._state
        if kept is None or now is None:
            return False
        with watch.stage("masks"):
            over = kept.is_over(frame.training)
        if over or kept.stays(frame.index):
            self._before_flash = None
        if not over:
            return False
        # Ids of Gaussians that came with the flash are not given again.
        self._state = replace(kept.state, frame=now.frame, next_id=now.next_id)
        self._scene = dequantise(self._state, self._header.lattice)
        self._motion, self._masks = kept.motion, kept.masks
        with watch.stage("settle"):
            self._watch_anew()
        return True

    def _coded(
        self, before: State, delta: Delta | None, index: int, *, whole: bool = False
    ) -> tuple[PacketKind, Coded]:
        """The frame as it is smallest to tell; where a segment opens, without what lies between it and the first.

        ``whole``: the decoder's state is not ``before``.
        """
        level, segment = self._settings.zstd_level, self._settings.segment
        if delta is not None and not (len(delta.rows) or len(delta.removed) or len(delta.added)):
            delta = None
        if whole or (segment and index % segment == 0):
            after = replace(before, frame=index) if delta is None else apply_delta(before, delta)
            return PacketKind.KEY, write_key(after, first=self._first_state, level=level)
        if delta is None:
            return PacketKind.SKIP, write_skip(before)
        return PacketKind.DELTA, write_delta(before, delta, level=level)

    def _go_on(
        self,
        frame: RigFrame,
        before: State,
        masks: Sequence[FrameMask],
        trained: NDArray[np.int64] | None,
        effects: Sequence[str],
        watch: Stopwatch,
        *,
        held: bool = False,
        hurried: bool = False,
    ) -> None:
        """All that later frames need to know of this one, whose state stands.

        ``trained``: rows that were, or None. ``effects``: those that it called for. ``held``: it waits for time; what
        moves is taken to move on. ``hurried``: what the scene now clearly misses is still to be done.
        """
        if trained is not None:
            with watch.stage("settle"):
                self._settle(before, trained)
            # Training that was given up, or whose changes were all taken back, has made up for nothing.
            if masks and not _same_scene(before, self._state):
                self._masks.trained(
                    frame.training, masks, moved="motion" in effects, shown=self._shown_on_budget() if hurried else None
                )
        self._masks.passed(frame.training, held=held)
        if held:
            self._held += 1
            return
        self._motion = self._displacements(before, self._state) / np.float32(1 + self._held)
        self._held = 0

    def _select(self, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
        if "select" in self._settings.frame.ablated:
            assert self._state is not None
            return np.ones(len(self._state), bool)
        used, settings = showing(masks), self._settings.frame.selection
        selected = self._inside(used, [masks[i].changing for i in used], settings)
        if any(masks[i].mends for i in used):
            stricter = replace(settings, least_share=settings.mend_share)
            selected |= self._inside(used, [masks[i].dilated for i in used], stricter)
        return selected

    def _inside(
        self, used: Sequence[int], regions: Sequence[NDArray[np.bool_]], settings: SelectionSettings
    ) -> NDArray[np.bool_]:
        """The Gaussians that the rule takes for these regions (H, W) of the ``used`` views."""
        views = [view_evidence(self._watch[i], region) for i, region in zip(used, regions, strict=True)]
        return select(views, settings)

    def _settle_key(self, frame: RigFrame, watch: Stopwatch) -> None:
        """All that later frames need to know of the first one."""
        with watch.stage("settle"):
            self._trainer = self._frame_trainer(self._scene)
        self._masks = MaskMemory(
            frame.training, self._settings.frame.masks, self._shown_on_budget(), threads=self._threads
        )
        self._motion = np.zeros((len(self._scene), 3), np.float32)

    def _shown_on_budget(self) -> list[FloatArray] | None:
        """What the views show, where a time budget may leave something of a frame undone."""
        if self._time is None or not self._watch:
            return None
        return [view.rgb for view in self._watch]

    def _settle(self, before: State, trained: NDArray[np.int64]) -> None:
        """The watching views go on from the frame's reconstructed state; only what was trained can differ."""
        assert self._state is not None
        ids = self._state.ids
        renumbered = np.searchsorted(ids, before.ids)
        renumbered[~np.isin(before.ids, ids, assume_unique=True)] = -1
        new = np.flatnonzero(~np.isin(ids, before.ids, assume_unique=True))
        rows = np.concatenate([np.setdiff1d(renumbered[trained], [-1]), new])
        for view in self._watch:
            view.settle(self._scene, rows, renumbered)
            view.refresh()

    def _watch_anew(self) -> None:
        """The watching views show the whole scene, whatever they showed before."""
        for view in self._watch:
            view.place(self._scene)
            view.refresh()

    def _delta(self, state: State, trained: TrainedFrame, economy: EconomySettings) -> Delta:
        lattice, before = self._header.lattice, take_rows(state, trained.kept)
        current = quantise(trained.values, lattice, near=before)
        if self._settings.method == "decogs":
            current = coarse_changes(before, current, economy.coarseness)
        added = quantise(trained.added, lattice)
        return difference(state, trained.kept, current, removed=trained.removed, added=added)

    def _commit(self, kind: PacketKind, frame: int, coded: Coded) -> Packet:
        """Reconstructs the next state from the packet's bytes, as the decoder will, and writes the packet."""
        packet = Packet(kind=kind, critical=True, frame=frame, payload=coded.payload, offset=0, ordinal=frame + 1)
        self._advance(packet)
        self._output.write(kind, frame, coded.payload)
        return packet

    def _advance(self, packet: Packet) -> None:
        self._state = reconstruct(self._state, packet, self._header, first=self._first_state)
        if self._first_state is None:
            self._first_state = self._state
        elif self._rate is not None:
            self._rate.wrote(packet.kind, packet.size)
        self._scene = dequantise(self._state, self._header.lattice)

    def _displacements(self, before: State, after: State | None) -> FloatArray:
        """How far every Gaussian of ``after`` moved in the last frame, (N, 3) world units; 0 for new ones."""
        assert after is not None
        motion = np.zeros((len(after), 3), np.float32)
        _, was, now = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
        steps = after.means[now].astype(np.float64) - before.means[was]
        motion[now] = steps * np.asarray(self._header.lattice.means)
        return motion

    def _report(
        self,
        frame: RigFrame,
        packet: Packet,
        costs: dict[str, int],
        selected: float,
        watch: Stopwatch,
        masks: Sequence[FrameMask],
    ) -> FrameReport:
        assert self._state is not None
        cpu_seconds = watch.cpu_seconds()
        with watch.stage("measure"):
            training = self._training_psnr(frame, showing(masks))
            held_out = mean_psnr(self._kernel, self._scene, self._ingest.held_out_views, frame.held_out)
        return FrameReport(
            frame.index,
            PacketKind(packet.kind).name.lower(),
            packet.size,
            len(self._state),
            selected,
            training,
            held_out if frame.held_out else None,
            watch.seconds,
            costs,
            cpu_seconds,
            left_out={
                view.camera.name: mask.lost for view, mask in zip(self._ingest.views, masks, strict=False) if mask.lost
            },
        )

    def _training_psnr(self, frame: RigFrame, seen: Sequence[int]) -> float:
        """Of the views in ``seen``, of all if there are none."""
        views, pictures = self._ingest.views, frame.training
        used = seen or range(len(views))
        return mean_picture_psnr([views[i] for i in used], self._shown(used), [pictures[i] for i in used])

    def _shown(self, used: Sequence[int]) -> list[FloatArray]:
        """What these views show of the scene, which DecoGS has drawn already; (3, H, W) each."""
        if self._watch:
            return [self._watch[i].rgb for i in used]
        return [self._kernel.forward(self._scene, self._ingest.views[i].pinhole).rgb for i in used]

    def _check_footage(self, frame: RigFrame, origin: str, masks: Sequence[FrameMask]) -> None:
        """Warns where the scene of an earlier encode is not what the rig's pictures show."""
        used = showing(masks) or range(len(self._ingest.views))
        views, pictures = [self._ingest.views[i] for i in used], [frame.training[i] for i in used]
        cameras = strange_cameras(views, pictures, self._shown(used))
        if cameras:
            self._on_warning(warning_of(origin, frame.index, cameras))

    def _stream_header(self, first: int, lattice: Lattice, sh_degree: int) -> StreamHeader:
        rig, document = self._ingest.rig, self._settings.as_document()
        if self._source is not None:
            document |= self._source.settings
        corrected = CorrectedCameras() if self._corrector is None else self._corrector.cameras
        return StreamHeader(
            cameras=self._ingest.cameras,
            lattice=lattice,
            sh_degree=sh_degree,
            fps=rig.fps,
            first_frame=first,
            effects=(*_carried(self._settings.effects, rig, sh_degree), *corrected.effects),
            held_out=tuple(view.camera.name for view in self._ingest.held_out_views),
            source_text=rig.source_text,
            licence=rig.licence,
            settings={"seed": self._seed, "scale": self._ingest.scale, **document},
            corrected=corrected,
        )

    def _frame_trainer(self, splats: Splats) -> FrameTrainer | BaselineTrainer:
        low, high = np.percentile(splats.means.astype(np.float64), [1, 99], axis=0)
        margin = 0.1 * (high - low) + 1e-6
        box, extent = (low - margin, high + margin), scene_extent(self._ingest.views) or 1.0
        kernel, views, seed, threads = self._kernel, self._ingest.views, self._seed, max(1, self._threads)
        if self._settings.method == "3dgstream":
            return BaselineTrainer(
                kernel,
                views,
                self._settings.baseline,
                population=len(splats),
                extent=extent,
                box=box,
                seed=seed,
                threads=threads,
            )
        self._watch = [fixed_view(kernel, view.pinhole) for view in views]
        self._watch_anew()
        return FrameTrainer(
            kernel,
            views,
            self._watch,
            self._settings.frame,
            extent=extent,
            box=box,
            seed=seed,
            threads=threads,
            most=round(MOST_GROWTH * len(splats)),
        )


def _carried(built: tuple[str, ...], rig: Rig, sh_degree: int) -> tuple[str, ...]:
    """The effects that a stream of this encode may carry and a decoder must know (SPEC.md, "Header packet")."""
    carried = [name for name in FRAME_EFFECTS if name in built]
    if sh_degree:
        carried.append("view_dependence")
    if any(is_distorted(camera) for camera in rig.cameras):
        carried.append("lens_distortion")
    return tuple(carried)


def encode_stream(
    ingest: Ingest,
    output: Path | BinaryIO | StreamOutput,
    span: range,
    settings: EncodeSettings,
    *,
    seed: int,
    threads: int,
    keyframe: KeyframeSource | None = None,
    device: str = "auto",
    resume: bool = False,
    on_frame: OnFrame | None = None,
    on_keyframe_step: OnKeyframeStep | None = None,
    anytime: AnytimeLog | None = None,
    on_warning: OnWarning | None = None,
) -> EncodeReport:
    """Encodes frames ``span`` of the rig to ``output``; Ctrl-C after the keyframe ends the stream early but whole.

    ``output``: a path, an open file that takes bytes, such as a pipe, or one that was taken already, for ``resume`` if
    that is asked for. ``keyframe``: an earlier stream's, to begin with instead of training one; UsageError when it
    does not fit the rig. ``resume``: go on with what an earlier encode left, in ``output`` + ".part" or as a shorter
    stream; the result has the bytes of one that was not cut off, but for a time budget, with which no two encodes have
    the same. ``anytime`` takes the loss of every step.
    Raises DecogsError for unusable input; complete frames then remain in ``output`` + ".part", and the message says so.
    """
    with output if isinstance(output, StreamOutput) else open_output(output, resume=resume) as target:
        left = _left(target, settings) if resume else None
        encoder = StreamEncoder(
            ingest,
            settings,
            target,
            seed=seed,
            threads=threads,
            keyframe=keyframe,
            device=device,
            anytime=anytime,
            on_warning=on_warning,
        )
        encoder.check_header(span.start)
        resumed = (0 if left is None else len(left.entries)) if resume else None
        packets: Iterator[Packet] = iter(())
        origin, last = "", 0
        if left is not None:
            encoder.take_over(left, span)
            packets, origin, last = left.packets(), f"--resume: {left.path}", len(left.entries) - 1
            if left.path != target.growing and left.ended and resumed == len(span):
                return EncodeReport(target.name, [], left.path.stat().st_size, False, resumed)
        reports: list[FrameReport] = []
        interrupted = False
        try:
            for frame in ingest.frames(span.start, span.stop):
                packet = next(packets, None)
                if packet is not None:
                    # The first and the last tell whether the pictures are those that it was made from.
                    report = encoder.replay(frame, packet, origin if len(reports) in (0, last) else "")
                elif not reports:
                    report = encoder.encode_key(frame, on_keyframe_step)
                else:
                    report = encoder.encode_next(frame)
                reports.append(report)
                if on_frame:
                    on_frame(report)
            target.open()
        except KeyboardInterrupt:
            if not reports or not target.is_open:
                raise
            interrupted = True
        except DecogsError as error:
            if reports and target.is_open and target.growing is not None:
                before = "the frame before it is" if len(reports) == 1 else f"the {len(reports)} frames before it are"
                error.args = (f"{error}; {before} in {target.growing}",)
            raise
        finally:
            target.close(len(reports))
        return EncodeReport(
            target.name, reports, target.publish(), interrupted, resumed, settings.frame_budget, settings.time_budget
        )


def _left(output: StreamOutput, settings: EncodeSettings) -> Interrupted | None:
    check_resumable(settings)
    return output.take_left() if isinstance(output, FileOutput) else None


def _same_scene(before: State, after: State | None) -> bool:
    """Whether nothing but the frame tells two states apart."""
    return after is not None and all(
        np.array_equal(getattr(before, name), getattr(after, name)) for name in ("ids", *ARRAYS)
    )


def _share(selected: NDArray[np.bool_]) -> float:
    return float(selected.mean()) if len(selected) else 0.0
