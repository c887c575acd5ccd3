"""A rig in, a stream out: the options of ``decogs-encode`` put to work."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, TextIO

from decogs.formats.container import MAX_FRAME
from decogs.formats.errors import UsageError
from decogs.formats.frame_ranges import frame_range
from decogs.formats.outputs import Output, check_outputs
from decogs.formats.rigs import Rig, files_of, open_rig
from decogs.formats.threads import thread_count

from .analysis import AUTO, Decision, wanted_effects, with_effects
from .analysis.analyse import analyse
from .coding.rate_control import with_budget, with_lossless, with_quality
from .coding.time_control import seconds_per_frame, with_target_psnr, with_time_budget
from .input.imported_keyframe import KeyframeSource, read_keyframe
from .input.ingest import Ingest, frame_span
from .output.convergence_log import ConvergenceLog
from .output.progress import EncodeProgress
from .output.reports import EncodeReport, OnWarning
from .output.stream_output import open_output
from .rasterise import check_device
from .settings.compensation import CorrectionSettings
from .settings.encode import EncodeSettings
from .settings.presets import preset as named_preset
from .stream import encode_stream
from .switches import with_method, with_selection, without
from .training.methods import FRAME_METHODS, require_sparse

_LEAST_SECONDS, _MOST_SECONDS = 1e-4, 1e6
"""Of a frame's time: what a clock tells apart, and twelve days."""


def encode(
    rig_dir: str | os.PathLike[str],
    output: str | os.PathLike[str] | BinaryIO,
    *,
    frames: str | slice | None = None,
    scale: float = 1.0,
    holdout: str | Sequence[str] = (),
    preset: str | EncodeSettings = "standard",
    method: str | None = None,
    ablate: str | Sequence[str] = (),
    selection: str | None = None,
    effects: str | None = None,
    keyframe: str | os.PathLike[str] | None = None,
    segment: int | None = None,
    quality: float | None = None,
    bitrate: float | None = None,
    max_mb_per_frame: float | None = None,
    lossless: bool = False,
    time_budget: float | str | None = None,
    target_psnr: float | None = None,
    corrections: CorrectionSettings | None = None,
    resume: bool = False,
    seed: int = 0,
    threads: int = 0,
    device: str = "auto",
    log: str | os.PathLike[str] | None = None,
    convergence_log: str | os.PathLike[str] | None = None,
    terminal: TextIO | None = None,
    on_warning: OnWarning | None = None,
) -> EncodeReport:
    """Encodes a rig of synchronised, calibrated cameras as a .dgs stream.

    ``output``: the file to write, or an open one that takes bytes, such as a pipe. No file of the rig, nor the one of
    ``keyframe``, is ever written over; an output that another encode writes, or has left unfinished, is refused.
    ``frames``: "A:B" half-open, as in Python, or a slice; all when None. ``scale``: of the pictures trained on.
    ``holdout``: cameras kept out of training and measured on. ``preset``: a name in PRESETS, or settings.
    ``method``: "decogs" or "3dgstream"; ``ablate``: parts of DecoGS to leave out, a list or text with commas;
    ``selection``: a name in SELECTION_RULES; all three on top of the preset (`switches`).
    ``effects``: "auto" looks at the rig
    first, for seconds, and builds what scene and frames call for; "all", "none", or names with commas, "-name" takes
    one away (`analysis`); None is "auto" for a named preset, and for settings what they say; the baseline has none.
    ``keyframe``: an earlier stream of the same rig, first frame and held-out cameras whose keyframe is taken as it is.
    ``segment``: frames from one keyframe to the next; later ones are coded as differences from the first.
    ``quality``: 0 (smallest) to 100 (most exact), 50 is the preset as it is; with ``keyframe``, that of later frames.
    ``max_mb_per_frame``, in units of 1e6 bytes, or ``bitrate``, in kbit/s at the rig's frame rate: most that the frames
    after the first may take on average, keyframes among them included. ``lossless``: every change is written exactly
    as trained, to the lattice's steps. ``time_budget``: seconds, or text such as "500ms/frame", that the frames after
    the first may take on average, wall clock; training is shortened to fit, and the bytes then depend on the machine.
    ``target_psnr``: dB in the training views' regions of interest (in a keyframe: everywhere) at which a frame's
    training ends. ``corrections``: cameras whose faults are known, instead of those that ``effects`` finds.
    ``resume``: go on with what an encode with the same options left in ``output`` + ".part", or as a shorter stream;
    the file gets the bytes of one that was not cut off.
    ``threads``: 0 means all processors; the stream does not depend on it. ``device``: "cuda" takes gsplat
    and gives other bits every time; "auto" is the CPU. ``log``: file for JSON lines.
    ``convergence_log``: file for the loss of every training step, as JSON lines; with ``resume``, both are continued.
    ``terminal``: where to show a progress bar, if it is one. ``on_warning`` is called as soon as something is found
    that the user should know of the rig, and of a stream or keyframe that does not show its pictures. Ctrl-C after the
    first frame ends the stream early but whole. Raises RigError, UsageError or TrainingError; nothing is then left
    under the output's name.
    """
    check_device(device)
    if seed < 0:
        raise UsageError(f"--seed {seed}: give a number of at least 0")
    settings = _settings(preset, method, [ablate] if isinstance(ablate, str) else ablate, selection)
    if segment is not None:
        if not 1 <= segment <= MAX_FRAME:
            raise UsageError(f"--segment {segment}: give a number of frames, at least 1 and at most {MAX_FRAME}")
        settings = replace(settings, segment=segment)
    source = None if keyframe is None else read_keyframe(keyframe)
    held = [holdout] if isinstance(holdout, str) else list(holdout)
    rig = open_rig(rig_dir)
    tell = on_warning or (lambda text: None)
    for warning in rig.warnings:
        tell(warning)
    settings = _with_rate(settings, rig, quality, bitrate, max_mb_per_frame, lossless=lossless)
    settings = _with_effort(settings, time_budget, target_psnr)
    span = frame_span(rig, frame_range(frames) if isinstance(frames, str) else frames)
    if effects is None and not isinstance(preset, EncodeSettings) and not FRAME_METHODS.get(settings.method).dense:
        effects = AUTO
    ingest = Ingest(rig, holdout=held, scale=scale)
    stream = Path(output) if isinstance(output, (str, os.PathLike)) else output
    log, convergence_log = (None if path is None else Path(path) for path in (log, convergence_log))
    _check_outputs(stream, log, convergence_log, rig, source)
    with (
        open_output(stream, resume=resume) as target,
        EncodeProgress(len(span), log, append=resume, terminal=terminal) as progress,
        nullcontext() if convergence_log is None else ConvergenceLog(convergence_log, append=resume) as curve,
    ):
        if effects is not None:
            settings = _with_effects(settings, effects, rig, held, span, threads, progress)
        if corrections is not None:
            settings = replace(settings, corrections=corrections)
        if settings.corrections.lens:
            ingest = Ingest(rig, holdout=held, scale=scale, lens=settings.corrections.lens)
        progress.started(
            {
                "rig": str(rig.path),
                "layout": rig.layout,
                "cameras": [camera.name for camera in rig.cameras],
                "held_out": held,
                "frames": [span.start, span.stop],
                "seed": seed,
                "keyframe": None if source is None else str(source.path),
                "resume": resume,
                "settings": settings.as_document(),
            }
        )
        report = encode_stream(
            ingest,
            target,
            span,
            settings,
            seed=seed,
            threads=thread_count(threads),
            keyframe=source,
            device=device,
            resume=resume,
            on_frame=progress.frame,
            on_keyframe_step=progress.keyframe_step,
            convergence=curve,
            on_warning=tell,
        )
        progress.finished(
            {
                "output": str(report.output),
                "bytes": report.total_bytes,
                "interrupted": report.interrupted,
                "resumed": report.resumed,
            }
        )
    return report


def _check_outputs(
    stream: Path | BinaryIO, log: Path | None, convergence_log: Path | None, rig: Rig, source: KeyframeSource | None
) -> None:
    """Raises UsageError when the encode would write over something it reads, or twice into one file."""
    outputs = [Output("-o", stream, grows=True)]
    logs = {"--log": log, "--convergence-log": convergence_log}
    outputs += [Output(name, path) for name, path in logs.items() if path is not None]
    read = [] if source is None else [(source.path, "is read, as --keyframe")]
    check_outputs(outputs, [*files_of(rig), *read])


def _settings(
    preset: str | EncodeSettings, method: str | None, ablate: Sequence[str], selection: str | None
) -> EncodeSettings:
    """The preset with the switches applied; what they rule out together, the later one says."""
    settings = preset if isinstance(preset, EncodeSettings) else named_preset(preset)
    if method is not None:
        settings = with_method(settings, method)
    settings = without(settings, [part.strip() for text in ablate for part in text.split(",") if part.strip()])
    return settings if selection is None else with_selection(settings, selection)


def _with_effort(
    settings: EncodeSettings, time_budget: float | str | None, target_psnr: float | None
) -> EncodeSettings:
    if time_budget is not None:
        seconds = seconds_per_frame(time_budget)
        if not _LEAST_SECONDS <= seconds <= _MOST_SECONDS:
            raise UsageError(
                f"--time-budget {time_budget}: give from {_LEAST_SECONDS:g} to {_MOST_SECONDS:g} seconds a frame"
            )
        settings = with_time_budget(settings, seconds)
    return settings if target_psnr is None else with_target_psnr(settings, target_psnr)


def _with_effects(
    settings: EncodeSettings,
    effects: str,
    rig: Rig,
    held: Sequence[str],
    span: range,
    threads: int,
    progress: EncodeProgress,
) -> EncodeSettings:
    """The settings with the effects that are wanted, of which the rig may have to be looked at."""
    require_sparse(settings, f"--effects {effects}", "has none of them")

    def decisions() -> Sequence[Decision]:
        look = slice(span.start, span.stop)
        found = analyse(rig, frames=look, holdout=held, threads=threads, on_step=progress.look_step)
        progress.looked({decision.effect: decision.cameras for decision in found.decisions if decision.detected})
        return found.decisions

    cameras = [camera.name for camera in rig.cameras if camera.name not in held]
    return with_effects(settings, wanted_effects(effects), cameras, decisions)


def _with_rate(
    settings: EncodeSettings,
    rig: Rig,
    quality: float | None,
    bitrate: float | None,
    max_mb_per_frame: float | None,
    *,
    lossless: bool,
) -> EncodeSettings:
    """The settings at that quality and budget; raises UsageError for those that exclude each other."""
    given = {"--quality": quality, "--bitrate": bitrate, "--max-mb-per-frame": max_mb_per_frame}
    asked = [name for name, value in given.items() if value is not None]
    if lossless:
        if asked:
            raise UsageError(f"--lossless: {asked[0]} asks for less than everything; drop one of the two")
        return with_lossless(settings)
    if bitrate is not None and max_mb_per_frame is not None:
        raise UsageError("--bitrate and --max-mb-per-frame are one budget in two units; drop one of the two")
    if quality is not None:
        settings = with_quality(settings, quality)
    if max_mb_per_frame is not None:
        return with_budget(settings, max_mb_per_frame * 1e6, f"--max-mb-per-frame {max_mb_per_frame:g}")
    if bitrate is not None:
        if rig.fps is None:
            raise UsageError(f"--bitrate: {rig.path} states no frame rate; use --max-mb-per-frame")
        return with_budget(settings, bitrate * 1000 / 8 / rig.fps, f"--bitrate {bitrate:g}")
    return settings
