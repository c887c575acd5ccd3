"""The closed loop: every frame is trained from what the decoder has of the frame before it.

Chosen: the encoder writes a packet, reconstructs the state from those very bytes, and trains the next frame from it,
so that quantisation errors cannot add up. The stream grows beside its final name (``NAME.part``) and is renamed when
it is done; what was complete when something went wrong stays in ``NAME.part``, a valid, shorter stream. Rejected:
training on the encoder's own floats and quantising afterwards (drifts: the error of frame t is never seen again).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from decogs.codec.deltas import Delta, difference
from decogs.codec.header import StreamHeader
from decogs.codec.keyframes import keyframe_state
from decogs.codec.lattice import Lattice, default_lattice, dequantise, quantise, robust_extent
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import State, take_rows
from decogs.codec.syntax import Coded, write_delta, write_key, write_skip
from decogs.decoder.lens import is_distorted
from decogs.formats.container import Packet, PacketKind, StreamWriter
from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.rigs import Rig
from decogs.formats.splats import FloatArray, Splats, sh_degree_of

from .baseline import BaselineTrainer
from .first_points import first_points
from .frame_training import FrameTrainer, TrainedFrame
from .ingest import Ingest, RigFrame
from .keyframe import mean_picture_psnr, mean_psnr, scene_extent, train_keyframe
from .keyframe_source import KeyframeSource
from .masks import FrameMask, MaskMemory
from .presets import EncodeSettings
from .rasterise import FixedView, fixed_view, training_kernel
from .selection import select, view_evidence

OnFrame = Callable[["FrameReport"], None]
OnKeyframeStep = Callable[[int, int, float], None]


@dataclass(frozen=True)
class FrameReport:
    """One encoded frame: the rig's index, how it was coded, what it cost and how it looks.

    ``bytes``: the packet's on disk. ``selected``: share of Gaussians in S_t. PSNRs in dB from the reconstructed state,
    means over the views; ``held_out_psnr`` None without held-out cameras. ``seconds`` by stage, wall clock.
    ``cpu_seconds``: processor time of all threads together, from decoded pictures to the written packet; measuring
    (the stage "measure") is left out.
    """

    frame: int
    kind: str
    bytes: int
    gaussians: int
    selected: float
    training_psnr: float
    held_out_psnr: float | None
    seconds: dict[str, float]
    costs: dict[str, int]
    cpu_seconds: float


@dataclass(frozen=True)
class EncodeReport:
    """What an encode made: the stream's path and its frames; ``interrupted`` when Ctrl-C ended it early."""

    output: Path
    frames: list[FrameReport]
    total_bytes: int
    interrupted: bool


@dataclass
class _Stopwatch:
    """Wall-clock seconds by stage, and processor seconds since it was made."""

    seconds: dict[str, float] = field(default_factory=dict)
    began: float = field(default_factory=time.process_time)

    def cpu_seconds(self) -> float:
        return time.process_time() - self.began

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin


class StreamEncoder:
    """Encodes frames one after the other into an open stream file; ``keyframe`` is one to begin with, untrained."""

    def __init__(
        self,
        ingest: Ingest,
        settings: EncodeSettings,
        *,
        seed: int,
        threads: int,
        keyframe: KeyframeSource | None = None,
        device: str = "auto",
    ) -> None:
        self._ingest, self._settings, self._seed, self._threads = ingest, settings, seed, threads
        self._source = keyframe
        self._kernel = training_kernel(device, threads)
        self._watch: list[FixedView] = []
        self._state: State | None = None
        self._motion: FloatArray = np.zeros((0, 3), np.float32)

    def encode_key(
        self, frame: RigFrame, open_writer: Callable[[bytes], StreamWriter], on_step: OnKeyframeStep | None
    ) -> FrameReport:
        """Trains or takes over the first frame and writes header and keyframe; the file is opened only then."""
        watch = _Stopwatch()
        if self._source is None:
            state, lattice = self._trained_keyframe(frame, watch, on_step)
        else:
            self._source.check(self._ingest, frame.index)
            self._ingest.set_near_planes(self._source.near_planes)
            state, lattice = self._source.state, self._source.header.lattice
        self._first = frame.index
        self._header = self._stream_header(lattice, sh_degree_of(state.coefficients))
        with watch.stage("write"):
            self._writer = open_writer(self._header.to_bytes())
            coded = write_key(state, level=self._settings.zstd_level)
            size = self._commit(PacketKind.KEY, 0, coded)
        with watch.stage("settle"):
            self._trainer = self._frame_trainer(self._scene)
        self._masks = MaskMemory(frame.training, self._settings.frame.masks)
        return self._report(frame, "key", size, coded, 1.0, watch)

    def _trained_keyframe(
        self, frame: RigFrame, watch: _Stopwatch, on_step: OnKeyframeStep | None
    ) -> tuple[State, Lattice]:
        """The keyframe's Gaussians on the lattice that suits them."""
        settings, views = self._settings, self._ingest.views
        with watch.stage("first_points"):
            points = first_points(
                [view.pinhole for view in views],
                [picture.transpose(1, 2, 0) for picture in frame.training],
                known=self._ingest.rig.points,
                cap=settings.keyframe.cap,
                seed=self._seed,
                threads=self._threads,
            )
        self._ingest.place_near_planes(points.xyz)
        views = self._ingest.views
        with watch.stage("keyframe"):
            trained = train_keyframe(
                self._kernel, views, frame.training, points, settings.keyframe, seed=self._seed, on_step=on_step
            )
        extent, centre = robust_extent(trained.splats.means)
        lattice = default_lattice(extent, centre=centre, quality=settings.quality)
        state, _ = keyframe_state(quantise(trained.splats, lattice))
        return state, lattice

    def encode_next(self, frame: RigFrame) -> FrameReport:
        """Trains and writes the next frame from the reconstructed state of the one before."""
        assert self._state is not None
        watch, state = _Stopwatch(), self._state
        train = self._train_all if self._settings.method == "3dgstream" else self._train_selected
        trained, share = train(frame, state, watch)
        with watch.stage("write"):
            delta = None if trained is None else self._delta(state, trained)
            index = frame.index - self._first
            if delta is None or not (len(delta.rows) or len(delta.removed) or len(delta.added)):
                kind, coded = PacketKind.SKIP, write_skip(state)
            else:
                kind, coded = PacketKind.DELTA, write_delta(state, delta, level=self._settings.zstd_level)
            size = self._commit(kind, index, coded)
        if trained is not None:
            with watch.stage("settle"):
                self._settle(state, trained)
        self._motion = self._displacements(state, self._state)
        return self._report(frame, kind.name.lower(), size, coded, share, watch)

    def finish(self) -> None:
        """Completes the stream with its index."""
        self._writer.finish()

    def _train_selected(self, frame: RigFrame, state: State, watch: _Stopwatch) -> tuple[TrainedFrame | None, float]:
        """What DecoGS changes, None when the frame selects nothing, and the share of Gaussians selected."""
        with watch.stage("masks"):
            masks = self._masks.masks(frame.training, [view.rgb for view in self._watch])
        selected: NDArray[np.bool_] = np.zeros(len(state), bool)
        trained: TrainedFrame | None = None
        if any(mask.raw.any() for mask in masks):
            with watch.stage("selection"):
                selected = self._select(masks)
            if selected.any():
                with watch.stage("training"):
                    trained = self._trainer.train(
                        self._scene, selected, frame.training, masks, self._motion, frame=frame.index - self._first
                    )
        if trained is not None:
            self._masks.trained(frame.training, masks)
        self._masks.passed(frame.training)
        return trained, float(selected.mean()) if len(selected) else 0.0

    def _train_all(self, frame: RigFrame, state: State, watch: _Stopwatch) -> tuple[TrainedFrame, float]:
        """What the dense baseline changes: it looks at no mask, selects nothing and so takes part in every frame."""
        with watch.stage("training"):
            everything = np.ones(len(state), bool)
            return self._trainer.train(
                self._scene, everything, frame.training, [], self._motion, frame=frame.index - self._first
            ), 1.0

    def _select(self, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
        if "select" in self._settings.frame.ablated:
            assert self._state is not None
            return np.ones(len(self._state), bool)
        settings = self._settings.frame.selection
        pairs = zip(self._watch, masks, strict=True)
        return select([view_evidence(view, mask.dilated, settings.rule) for view, mask in pairs], settings)

    def _settle(self, before: State, trained: TrainedFrame) -> None:
        """The watching views go on from the frame's reconstructed state; only what was trained can differ."""
        assert self._state is not None
        ids = self._state.ids
        renumbered = np.searchsorted(ids, before.ids)
        renumbered[~np.isin(before.ids, ids, assume_unique=True)] = -1
        new = np.flatnonzero(~np.isin(ids, before.ids, assume_unique=True))
        rows = np.concatenate([np.setdiff1d(renumbered[trained.kept], [-1]), new])
        for view in self._watch:
            view.settle(self._scene, rows, renumbered)
            view.refresh()

    def _delta(self, state: State, trained: TrainedFrame) -> Delta:
        lattice = self._header.lattice
        current = quantise(trained.values, lattice, near=take_rows(state, trained.kept))
        added = quantise(trained.added, lattice)
        return difference(state, trained.kept, current, removed=trained.removed, added=added)

    def _commit(self, kind: PacketKind, frame: int, coded: Coded) -> int:
        """Reconstructs the next state from the packet's bytes, as the decoder will, and writes the packet."""
        packet = Packet(kind=kind, critical=True, frame=frame, payload=coded.payload, offset=0, ordinal=frame + 1)
        self._state = reconstruct(self._state, packet, self._header)
        self._scene = dequantise(self._state, self._header.lattice)
        return self._writer.write(kind, frame, coded.payload)

    def _displacements(self, before: State, after: State | None) -> FloatArray:
        """How far every Gaussian of ``after`` moved in the last frame, (N, 3) world units; 0 for new ones."""
        assert after is not None
        motion = np.zeros((len(after), 3), np.float32)
        _, was, now = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
        steps = after.means[now].astype(np.float64) - before.means[was]
        motion[now] = steps * np.asarray(self._header.lattice.means)
        return motion

    def _report(
        self, frame: RigFrame, kind: str, size: int, coded: Coded, selected: float, watch: _Stopwatch
    ) -> FrameReport:
        assert self._state is not None
        if kind == "key":
            self._motion = np.zeros((len(self._state), 3), np.float32)
        cpu_seconds = watch.cpu_seconds()
        with watch.stage("measure"):
            training = self._training_psnr(frame)
            held_out = mean_psnr(self._kernel, self._scene, self._ingest.held_out_views, frame.held_out)
        return FrameReport(
            frame.index,
            kind,
            size,
            len(self._state),
            selected,
            training,
            held_out if frame.held_out else None,
            watch.seconds,
            coded.costs,
            cpu_seconds,
        )

    def _training_psnr(self, frame: RigFrame) -> float:
        """Of the training views, which DecoGS has drawn already."""
        if not self._watch:
            return mean_psnr(self._kernel, self._scene, self._ingest.views, frame.training)
        return mean_picture_psnr(self._ingest.views, [view.rgb for view in self._watch], frame.training)

    def _stream_header(self, lattice: Lattice, sh_degree: int) -> StreamHeader:
        rig, document = self._ingest.rig, self._settings.as_document()
        if self._source is not None:
            document |= self._source.settings
        return StreamHeader(
            cameras=self._ingest.cameras,
            lattice=lattice,
            sh_degree=sh_degree,
            fps=rig.fps,
            first_frame=self._first,
            effects=_effects(rig, sh_degree),
            held_out=tuple(view.camera.name for view in self._ingest.held_out_views),
            source_text=rig.source_text,
            licence=rig.licence,
            settings={"seed": self._seed, "scale": self._ingest.scale, **document},
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
        for view in self._watch:
            view.place(splats)
            view.refresh()
        return FrameTrainer(
            kernel, views, self._watch, self._settings.frame, extent=extent, box=box, seed=seed, threads=threads
        )


def _effects(rig: Rig, sh_degree: int) -> tuple[str, ...]:
    """What a stream of this encode may carry (SPEC.md, "Header packet")."""
    effects = ["motion", "appearance_change", "emergence", "disappearance"]
    if sh_degree:
        effects.append("view_dependence")
    if any(is_distorted(camera) for camera in rig.cameras):
        effects.append("lens_distortion")
    return tuple(effects)


def frame_span(rig: Rig, frames: slice | None) -> range:
    """The rig's frames that ``frames`` names, as Python would; raises UsageError when there are none or they skip."""
    chosen = range(rig.frame_count)[slice(None) if frames is None else frames]
    if not len(chosen):
        raise UsageError(f"--frames: {rig.path} has frames 0 to {rig.frame_count - 1}; the range holds none of them")
    if chosen.step != 1:
        raise UsageError("--frames: give consecutive frames, A:B")
    return chosen


def encode_stream(
    ingest: Ingest,
    output: Path,
    span: range,
    settings: EncodeSettings,
    *,
    seed: int,
    threads: int,
    keyframe: KeyframeSource | None = None,
    device: str = "auto",
    on_frame: OnFrame | None = None,
    on_keyframe_step: OnKeyframeStep | None = None,
) -> EncodeReport:
    """Encodes frames ``span`` of the rig to ``output``; Ctrl-C after the keyframe ends the stream early but whole.

    ``keyframe``: an earlier stream's, to begin with instead of training one; UsageError when it does not fit the rig.
    Raises DecogsError for unusable input; complete frames then remain in ``output`` + ".part", and the message says so.
    """
    _check_output(output)
    growing = output.with_name(output.name + ".part")
    encoder = StreamEncoder(ingest, settings, seed=seed, threads=threads, keyframe=keyframe, device=device)
    reports: list[FrameReport] = []
    interrupted = False
    file: BinaryIO | None = None
    writer: StreamWriter | None = None

    def open_writer(header: bytes) -> StreamWriter:
        nonlocal file, writer
        file = growing.open("wb")
        writer = StreamWriter(file, header)
        return writer

    try:
        for frame in ingest.frames(span.start, span.stop):
            if not reports:
                report = encoder.encode_key(frame, open_writer, on_keyframe_step)
            else:
                report = encoder.encode_next(frame)
            reports.append(report)
            if on_frame:
                on_frame(report)
    except KeyboardInterrupt:
        if not reports:
            raise
        interrupted = True
    except DecogsError as error:
        if reports:
            error.args = (f"{error}; the {len(reports)} frames before it are in {growing}",)
        raise
    finally:
        if file is not None:
            if reports and writer is not None:
                _cut_after(len(reports), file, writer)
                encoder.finish()
            file.close()
            if not reports:
                growing.unlink(missing_ok=True)
    os.replace(growing, output)
    return EncodeReport(output, reports, output.stat().st_size, interrupted)


def _check_output(output: Path) -> None:
    """Training takes minutes: what can be known about writing is said before it begins."""
    if output.is_dir():
        raise UsageError(f"{output}: is a folder; name a file in it, such as {output / 'scene.dgs'}")
    if not output.parent.is_dir():
        raise UsageError(f"{output.parent}: no such folder; create it first")
    if not os.access(output.parent, os.W_OK):
        raise UsageError(f"{output.parent}: cannot be written to; choose another folder")


def _cut_after(frames: int, file: BinaryIO, writer: StreamWriter) -> None:
    """Takes off what an interruption left, in whole or in part, of a packet after the first ``frames``."""
    if len(writer.entries) > frames:
        end = writer.entries[frames].offset
        file.seek(end)
        file.truncate()
        del writer.entries[frames:]
        writer.bytes_written = end
