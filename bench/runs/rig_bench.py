"""Runs of variants over rigs: encoded from one shared keyframe, measured, and kept as one JSON file each.

A run is looked for by its rig and a digest of everything that decides it, so that a report that was interrupted goes on
where it stopped. One made by other code is made again in its place, unless the caller takes it as it is: the file says
which code it was. Chosen: one file per run rather than one for all, so that an interruption or a damaged file costs one
run. Rejected: the code in the digest (every edit would leave a file behind that nobody asks for again).

Every variant is run with every seed of the report, each from that seed's shared keyframe, so that rows are paired
within a seed. Chosen: the seed as a part of the variant, so that runs and streams of every seed are found alike.
Rejected: all seeds in one file (an interruption would cost them all), and a RigBench for every seed (each would find
the same regions and effects again).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields, replace
from datetime import datetime, timezone
from functools import cached_property
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.analysis import AUTO, Decision, with_effects
from decogs.encoder.analysis.analyse import analyse
from decogs.encoder.frame.context import Context
from decogs.encoder.input.imported_keyframe import read_keyframe
from decogs.encoder.output.reports import EncodeReport, FrameReport, OnKeyframeStep
from decogs.encoder.settings.effects import PRESET_EFFECTS
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.stream.options import RunOptions
from decogs.encoder.stream.run import encode_stream
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import GrowingFile, write_whole
from decogs.formats.rigs import open_rig
from decogs.formats.splats import Splats
from decogs.formats.system.threads import thread_count
from decogs.rig.pictures.ingest import Ingest, frame_span

from ..estimates import rounded
from ..machine import code_version, load, machine_facts
from ..measures.metrics import BytePicture
from ..measures.perceptual import installed_network, perceptual_distance
from ..measures.quality import FrameOfViews, HeldOut, StreamQuality, measure_scenes
from ..measures.regions import Regions, find_regions, held_out_pictures, static_column, true_mattes
from ..questions.variants import Variant, settings_of
from ..timing import TIMINGS, retimed
from . import error_maps
from .documents import digest, document
from .rigs import held_out_cameras, result_name
from .run import FORMAT, KEYFRAME, BenchOptions, FrameCost, Run, RunFrame, read_run

MOST_SEEDS = 100


class RigBench:
    """One rig of a report: its held-out cameras, frames and masks, and the runs over it.

    Figures are means over all ``cameras`` held out; ``camera``, the first of them, is the one that pictures show.
    """

    def __init__(self, rig_dir: str | os.PathLike[str], output: Path, options: BenchOptions) -> None:
        """Raises RigError and UsageError for a rig or options that cannot be measured; nothing is trained yet."""
        _check_seeds(options.seeds)
        settings_of(KEYFRAME, options.preset)
        self.rig = open_rig(rig_dir)
        self.name = result_name(self.rig)
        self.options = options
        self.cameras = held_out_cameras(self.rig, options.holdout)
        self.frames = frame_span(self.rig, options.frames)
        if len(self.frames) < 2:
            raise UsageError(f"{self.rig.path}: a report compares frames; give `frames` of at least 2")
        Ingest(self.rig, holdout=self.cameras, scale=options.scale)
        self._threads = thread_count(options.threads)
        self.runs_folder, self._streams = output / "runs", output / "streams"

    @property
    def camera(self) -> str:
        """The first camera left out, the one that is shown."""
        return self.cameras[0]

    @cached_property
    def _regions(self) -> dict[str, Regions]:
        return {name: find_regions(self.rig, name, self.frames, self.options.scale) for name in self.cameras}

    @property
    def regions(self) -> Regions:
        """Static and dynamic pixels of ``camera``, from all frames of the report, whatever a variant's stride."""
        return self._regions[self.camera]

    @cached_property
    def column(self) -> int:
        """The image column that the scanlines follow."""
        return static_column(self.regions, next(self._recorded(self.frames[:1])))

    def recorded_column(self) -> NDArray[np.uint8]:
        """That column as recorded, (H, T, 3)."""
        return np.stack([picture[:, self.column] for picture in self._recorded(self.frames)], axis=1)

    @cached_property
    def _decisions(self) -> tuple[Decision, ...]:
        """What the report's frames call for."""
        span = slice(self.frames.start, self.frames.stop)
        return analyse(self.rig.path, holdout=self.cameras, frames=span, threads=self._threads).decisions

    def settings(self, variant: Variant) -> EncodeSettings:
        """Everything that a variant's encode of this rig does."""
        settings = settings_of(variant, self.options.preset)
        if variant.effects is None:
            return settings
        wanted = variant.effects
        if wanted.base == AUTO:
            # What the scene does not call for cannot wrongly be left out; what no analysis decides, frames do.
            uncalled = {decision.effect for decision in self._decisions if not decision.detected}
            wanted = replace(wanted, dropped=wanted.dropped - uncalled)
        cameras = [camera.name for camera in self.rig.cameras if camera.name not in self.cameras]
        return with_effects(settings, wanted, cameras, lambda: self._decisions)

    def _trains_keyframe(self, variant: Variant) -> bool:
        """Effects may ask for another keyframe than the shared one."""
        if variant.own_keyframe or variant.effects is None:
            return variant.own_keyframe
        own, shared = self.settings(variant), settings_of(KEYFRAME, self.options.preset)
        return (own.keyframe, own.corrections) != (shared.keyframe, shared.corrections)

    def seeded(self, variants: Sequence[Variant]) -> list[Variant]:
        """The variants with each of the report's seeds, seed by seed."""
        return [replace(variant, seed=seed) for seed in self.options.seeds for variant in variants]

    def frames_of(self, variant: Variant) -> Sequence[int]:
        """The rig's frames that the variant encodes, in its order."""
        strided = self.frames[:: variant.stride]
        frames = strided if variant.timing is None else TIMINGS[variant.timing](strided)
        return frames[variant.frames :] if (variant.frames or 0) < 0 else frames[: variant.frames]

    def find(self, variant: Variant) -> Run | None:
        """The run of this variant that an earlier report left, or None."""
        for path in sorted(self.runs_folder.glob(f"{self.name}-*-{self.key(variant)}.json")):
            run = read_run(path)
            if run is not None and (self.options.any_code or run.code == code_version()):
                return run
        return None

    def file_of(self, run: Run) -> Path:
        """Where the run's JSON lies."""
        return self.runs_folder / f"{run.rig}-{run.variant}-{run.key}.json"

    def column_of(self, run: Run) -> NDArray[np.uint8]:
        """The followed column as the run shows it, (H, T, 3)."""
        path = self.file_of(run).with_suffix(".png")
        picture = cv2.imread(str(path))
        if picture is None:
            raise UsageError(f"{path}: is missing or damaged; remove {self.file_of(run).name} to make it again")
        return np.asarray(picture[..., ::-1], np.uint8)

    def errors_of(self, run: Run) -> dict[str, NDArray[np.float32]]:
        """Maps of the run's errors by held-out camera, as `error_maps` keeps them; none where an older bench ran."""
        path = self.file_of(run).with_suffix(".npz")
        try:
            return dict(zip(self.cameras, error_maps.unpacked(path), strict=True))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, KeyError, BadZipFile):
            raise UsageError(f"{path}: is damaged; remove {self.file_of(run).name} to make it again") from None

    def recorded_first(self, camera: str) -> BytePicture:
        """What the camera recorded in the first frame, (H, W, 3)."""
        return next(self._recorded(self.frames[:1], camera))

    def run(
        self,
        variant: Variant,
        *,
        on_frame: Callable[[], None] | None = None,
        on_keyframe_step: OnKeyframeStep | None = None,
        keep_stream: bool = False,
    ) -> Run:
        """Encodes and measures a variant and keeps the result; Ctrl-C and errors leave no half result.

        ``on_frame`` is called after each of the variant's own frames, ``on_keyframe_step`` while a keyframe is trained.
        ``keep_stream``: leave the .dgs file for ``stream``, whatever the options say; ``tidy`` removes it.
        """
        self.runs_folder.mkdir(parents=True, exist_ok=True)
        self._streams.mkdir(parents=True, exist_ok=True)
        keyframe = None if self._trains_keyframe(variant) else self.stream(_keyframe_of(variant), on_keyframe_step)
        loads = [load()]
        report = self._encode(variant, keyframe, on_frame, on_keyframe_step)
        loads.append(load())
        with open_stream(report.output, strict=True) as stream:
            scenes = (frame.splats for frame in stream.frames())
            quality = self.measured(stream.header, scenes, self.frames_of(variant))
        run = self._result(variant, report, quality, loads)
        write_whole(self.file_of(run).with_suffix(".png"), _png(quality.column))
        write_whole(self.file_of(run).with_suffix(".npz"), error_maps.packed(quality.errors))
        write_whole(self.file_of(run), document(run).encode())
        if not (keep_stream or self.options.keep_streams):
            report.output.unlink()
        return run

    def measured(self, header: StreamHeader, scenes: Iterator[Splats], frames: Sequence[int]) -> StreamQuality:
        """What the held-out cameras see of decoded scenes, one for each of the rig's ``frames``."""
        views = [self._held_out(name, frames) for name in self.cameras]
        return measure_scenes(
            header,
            scenes,
            views,
            scale=self.options.scale,
            threads=self._threads,
            column=self.column,
            distance=perceptual_distance(installed_network()),
        )

    def _held_out(self, camera: str, frames: Sequence[int]) -> HeldOut:
        mattes = true_mattes(self.rig, camera, frames, self.options.scale)
        return HeldOut(camera, self._recorded(frames, camera), self._regions[camera], mattes)

    def stream(self, variant: Variant, on_keyframe_step: OnKeyframeStep | None = None) -> Path:
        """The variant's stream; encoded (again) when it is not there or was made by other code."""
        if self.find(variant) is None or not self._stream(variant).is_file():
            self.run(variant, on_keyframe_step=on_keyframe_step, keep_stream=True)
        return self._stream(variant)

    def tidy(self, lent: Sequence[Variant]) -> None:
        """Removes the streams of ``lent``, which ``stream`` gave, of all seeds, and their folder when it is empty."""
        if self.options.keep_streams or not self._streams.is_dir():
            return
        for variant in self.seeded(lent):
            self._stream(variant).unlink(missing_ok=True)
        if not any(self._streams.iterdir()):
            self._streams.rmdir()

    def _stream(self, variant: Variant) -> Path:
        return self._streams / f"{self.name}-{variant.name}-{self.key(variant)}.dgs"

    def _encode(
        self,
        variant: Variant,
        keyframe: Path | None,
        on_frame: Callable[[], None] | None,
        on_keyframe_step: OnKeyframeStep | None,
    ) -> EncodeReport:
        frames = self.frames_of(variant)
        first = frames[0]
        settings = self.settings(variant)
        ingest = Ingest(
            retimed(self.rig, frames),
            holdout=self.cameras,
            scale=self._training_scale(variant),
            lens=settings.corrections.lens,
        )
        # What an interrupted report left of it is worth nothing: runs are timed as a whole.
        GrowingFile(self._stream(variant), leftover="dropped").release()
        context = Context.of(ingest, settings, seed=self._seed(variant), threads=self._threads)
        options = RunOptions(
            keyframe=None if keyframe is None else read_keyframe(keyframe).refined(variant.refined),
            on_frame=None if on_frame is None else lambda _: on_frame(),
            on_keyframe_step=on_keyframe_step,
        )
        report = encode_stream(context, self._stream(variant), range(first, first + len(frames)), options)
        if report.interrupted:
            report.output.unlink(missing_ok=True)
            raise KeyboardInterrupt
        return report

    def _seed(self, variant: Variant) -> int:
        return self.options.seeds[0] if variant.seed is None else variant.seed

    def _training_scale(self, variant: Variant) -> float:
        return self.options.scale * variant.scale

    def _recorded(self, frames: Sequence[int], camera: str | None = None) -> Iterator[BytePicture]:
        return held_out_pictures(self.rig, camera or self.camera, frames, self.options.scale)

    def key(self, variant: Variant) -> str:
        """Digest of everything that decides the stream, and of the number of threads, which decides how long it takes.

        Variants of the same key are the same run, whatever they are called.
        """
        options, rig, frames = self.options, self.rig, self.frames_of(variant)
        facts: dict[str, Any] = {} if variant.scale == 1 else {"training_scale": variant.scale}
        settings = self.settings(variant)
        # A stream's settings do not say what its header's cameras do.
        off = [name for name in ("falloff", "rolling_shutter") if not getattr(settings.corrections, name)]
        facts |= {"without": off} if off else {}
        return digest(
            facts
            | {
                "format": FORMAT,
                "settings": settings.as_document(),
                "own_keyframe": self._trains_keyframe(variant),
                "refined": variant.refined,
                "rig": [self.name, rig.layout, rig.frame_count, [camera.name for camera in rig.cameras]],
                "frames": [frames.start, frames.stop, frames.step] if isinstance(frames, range) else frames,
                "options": [",".join(self.cameras), options.scale, self._seed(variant), self._threads],
            }
        )

    def _result(self, variant: Variant, report: EncodeReport, quality: StreamQuality, loads: list[float]) -> Run:
        options, frames = self.options, self.frames_of(variant)
        pairs = zip(frames, report.frames, quality.frames, strict=True)
        return Run(
            rig=self.name,
            variant=variant.name,
            description=variant.description,
            key=self.key(variant),
            code=code_version(),
            date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
            machine=machine_facts(),
            load=loads,
            camera=",".join(self.cameras),
            span=[min(frames), max(frames) + 1, variant.stride],
            scale=options.scale,
            seed=self._seed(variant),
            threads=self._threads,
            preset=variant.preset or options.preset,
            command=self._command(variant, frames),
            changed={path: str(value) for path, value in variant.settings.items()},
            settings=self.settings(variant).as_document(),
            masks=self.regions.about,
            lpips_network=installed_network(),
            render_seconds=quality.render_seconds,
            read_seconds=quality.read_seconds,
            decode_cpu_seconds=quality.decode_cpu_seconds,
            read_cpu_seconds=quality.read_cpu_seconds,
            first_cpu_seconds=quality.first_cpu_seconds,
            stream_bytes=report.total_bytes,
            column=self.column,
            frames=[_frame(index, cost, looks) for index, cost, looks in pairs],
        )

    def _command(self, variant: Variant, frames: Sequence[int]) -> str:
        """The encode as a command; stride, timing and changed settings have no option of their own: words follow."""
        options = self.options
        words = ["decogs-encode", self.name, "-o", f"{variant.name}.dgs"]
        words += [word for camera in self.cameras for word in ("--holdout", camera)]
        words += ["--frames", f"{min(frames)}:{max(frames) + 1}", "--preset", variant.preset or options.preset]
        words += ["--seed", str(self._seed(variant)), "--threads", str(self._threads)]
        scale = self._training_scale(variant)
        words += [] if scale == 1 else ["--scale", f"{scale:g}"]
        words += ["--method", variant.method] if variant.method else []
        words += ["--ablate", ",".join(variant.ablate)] if variant.ablate else []
        words += ["--selection", variant.selection] if variant.selection else []
        words += [] if variant.quality is None else ["--quality", f"{variant.quality:g}"]
        words += ["--effects", ",".join(PRESET_EFFECTS) if variant.effects is None else str(variant.effects)]
        words += [] if self._trains_keyframe(variant) else ["--keyframe", f"{KEYFRAME.name}.dgs"]
        extra = [] if variant.stride == 1 else [f"every {variant.stride}. frame"]
        extra += [] if variant.timing is None else [f"frames {', '.join(map(str, frames))}"]
        extra += [f"{path} = {value}" for path, value in variant.settings.items()]
        return " ".join(words) + (f" ({', '.join(extra)})" if extra else "")


def _keyframe_of(variant: Variant) -> Variant:
    """The shared keyframe that the variant starts from: its seed's."""
    return replace(KEYFRAME, seed=variant.seed)


def _check_seeds(seeds: Sequence[int]) -> None:
    if not 1 <= len(seeds) <= MOST_SEEDS or len(set(seeds)) < len(seeds) or min(seeds) < 0:
        raise UsageError(f"`seeds`: give 1 to {MOST_SEEDS} different numbers of at least 0")


def _frame(index: int, cost: FrameReport, looks: FrameOfViews) -> RunFrame:
    values = {f.name: getattr(cost, f.name) for f in fields(FrameCost)} | asdict(looks)
    values["frame"] = index
    values["seconds"] = {stage: seconds for stage, seconds in cost.seconds.items() if stage != "measure"}
    return RunFrame(**rounded(values))


def _png(picture: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]))[1].tobytes())
