"""A rig in, a stream out: what ``decogs-encode`` does."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from decogs.formats.errors import RigError, UsageError
from decogs.formats.files.outputs import JSON, STREAM, Output, check_outputs, files_read
from decogs.formats.rigs import Rig, files_of, is_live, open_rig, stop_waiting, without_cameras
from decogs.formats.stream.container import MAX_FRAME
from decogs.formats.system.callbacks import OnWarning
from decogs.formats.system.threads import thread_count
from decogs.rig.check.faults import REFUSED
from decogs.rig.check.mattes import check_mattes
from decogs.rig.mattes import Mattes, files_of_mattes, open_mattes
from decogs.rig.pictures.compositing import background_for
from decogs.rig.pictures.ingest import Ingest, check_held_out, frame_span

from .analysis import Decision, EffectChoice, effect_choice, with_effects
from .analysis.analyse import analyse
from .analysis.building import decided_beforehand
from .backends import check_device
from .frame.context import Context
from .input.imported_keyframe import KeyframeSource, read_keyframe
from .input.imported_splats import SplatSource, is_splat_file, read_splat_source
from .input.sound import SoundSource, sound_source
from .job.job import EncodeJob
from .job.switches import Switches, check_together, with_switches
from .job.targets import Targets, with_targets
from .layering.recording import LayeredOutput
from .methods import FRAME_METHODS, require_sparse
from .output.convergence_log import ConvergenceLog
from .output.encode_log import EncodeLog
from .output.observer import EncodeObserver, Observers
from .output.reports import EncodeReport, left_out_warnings
from .output.stream_output import open_output
from .parts.base import Base, read_base
from .parts.encoding import encode_part
from .parts.manifest import part_frames
from .parts.output import open_part
from .settings.encode import EncodeSettings
from .settings.presets import preset
from .stream.memory_limit import EncodeMemory, memory_within
from .stream.options import RunOptions
from .stream.run import encode_stream


def encode(
    job: EncodeJob, *, progress: EncodeObserver | None = None, on_warning: OnWarning | None = None
) -> EncodeReport:
    """Encodes a rig as a .dgs stream, or a part of one.

    ``progress`` observes every step and frame. ``on_warning`` is called as soon as something is found that the user
    should know of the rig, and of a stream or keyframe that does not show its pictures; at the end, for cameras that
    were left out of frames.

    Ctrl-C after the first frame ends the stream early but whole. Raises RigError, UsageError, StreamError for a damaged
    ``keyframe``, or TrainingError; nothing is then left under the output's name.
    """
    warn = on_warning or (lambda text: None)
    work = _prepare(job, warn)
    with ExitStack() as open_files:
        open_files.callback(stop_waiting, work.rig.sources)  # of the frame that is read ahead
        taken = open_output(work.output, resume=job.resume) if work.part is None else open_part(work.output)
        target = open_files.enter_context(LayeredOutput(taken, thread_count(job.threads)) if job.layers else taken)
        observers = [] if job.log is None else [open_files.enter_context(EncodeLog(Path(job.log), append=job.resume))]
        observer = Observers([*observers, *([] if progress is None else [progress])])
        curve = None
        if job.convergence_log is not None:
            curve = open_files.enter_context(ConvergenceLog(Path(job.convergence_log), append=job.resume))
        warned_frames: dict[str, set[int]] = {}
        chosen = _decide_settings(job, work, observer, warn, warned_frames)
        ingest = work.ingest
        if chosen.corrections.lens:
            lens = chosen.corrections.lens
            ingest = Ingest(
                work.rig,
                holdout=job.holdout,
                scale=job.scale,
                lens=lens,
                mattes=work.mattes,
                background=ingest.background,
            )
        observer.started(_facts(job, work, ingest, chosen))
        context = Context.of(
            ingest,
            chosen,
            seed=job.seed,
            threads=thread_count(job.threads),
            device=job.device,
            on_loss=None if curve is None else curve.step,
        )
        options = RunOptions(
            keyframe=work.source,
            metrics=job.metrics,
            sound=work.sound,
            read_ahead=work.memory.reads_ahead,
            on_frame=observer.frame,
            on_keyframe_step=observer.keyframe_step,
            convergence=curve,
            on_warning=warn,
        )
        if work.part is None:
            report = encode_stream(context, target, work.span, options, resume=job.resume)
        else:
            report = encode_part(context, target, work.part, work.span, options, work.base, device=job.device)
        report = replace(report, held_out_sizes=ingest.held_out_sizes)
        for text in left_out_warnings(report.frames, warned_frames):
            warn(text)
        observer.finished(
            {
                "output": str(report.output),
                "bytes": report.total_bytes,
                "interrupted": report.interrupted,
                "resumed": report.resumed,
            }
        )
    return report


@dataclass(frozen=True)
class _Work:
    """A job that was checked: what is read, from where it starts, and where it goes.

    ``base``: the part that a part starts from. ``source``: another keyframe to begin with. ``span``: the take's frames,
    ``part``: those of a part, None for a whole stream.
    """

    rig: Rig
    mattes: Mattes | None
    ingest: Ingest
    output: Path | BinaryIO
    settings: EncodeSettings
    wanted: EffectChoice | None
    span: range
    part: range | None
    base: Base | None
    source: KeyframeSource | SplatSource | None
    sound: SoundSource | None
    memory: EncodeMemory


def _prepare(job: EncodeJob, warn: OnWarning) -> _Work:
    """All that can be checked before work begins; raises what `encode` raises."""
    check_device(job.device)
    if not (isinstance(job.seed, int) and job.seed >= 0):
        raise UsageError(f"`seed` {job.seed}: give a number of at least 0, a whole one")
    if job.layers and (job.resume or job.only is not None):
        other = "resume" if job.resume else "only"
        raise UsageError(f"`layers` while recording: not with `{other}`; encode without, then use `edit`")
    settings = chosen_settings(job)
    base = _base(settings, job)
    source = None if base is not None else source_of(job)
    rig = job.rig if isinstance(job.rig, Rig) else open_rig(job.rig)
    for warning in rig.warnings:
        warn(warning)
    rig = without_cameras(rig, job.exclude)
    span = frame_span(rig, job.frames)
    part = None if job.only is None else part_frames(job.only, span, settings.segment)
    wanted = wanted_effects(job, settings)
    check_held_out(rig, job.holdout)
    mattes = open_mattes(job.mattes, rig, span, job.holdout)
    ingest = Ingest(rig, holdout=job.holdout, scale=job.scale, mattes=mattes)
    output = Path(job.output) if isinstance(job.output, (str, os.PathLike)) else job.output
    sound = sound_source(job.audio, rig, span.start, warn)
    _check_outputs(job, output, rig, mattes)
    if ingest.has_mattes:
        first = next(ingest.frames(span.start, span.start + 1))
        check_mattes(ingest, first, warn)
        ingest.background = background_for(first.training, first.alpha)
    begun = source if base is None else base.source
    memory = memory_within(
        ingest,
        settings,
        job.max_memory,
        gaussians=0 if begun is None else begun.count,
        frames=len(span),
        threads=thread_count(job.threads),
    )
    return _Work(rig, mattes, ingest, output, settings, wanted, span, part, base, source, sound, memory)


def _decide_settings(
    job: EncodeJob, work: _Work, observer: EncodeObserver, warn: OnWarning, warned_frames: dict[str, set[int]]
) -> EncodeSettings:
    """The settings with the requested effects and corrections, for which the rig may have to be analysed.

    ``warned_frames`` gets, by camera, the frames of which that has warned.
    """
    if work.base is not None:
        asked = work.settings if job.corrections is None else replace(work.settings, corrections=job.corrections)
        return work.base.settings(asked, work.wanted)
    settings = work.settings
    if work.wanted is not None:
        settings = _with_effects(settings, work.wanted, job, work, observer, warn, warned_frames)
    return settings if job.corrections is None else replace(settings, corrections=job.corrections)


def _facts(job: EncodeJob, work: _Work, ingest: Ingest, settings: EncodeSettings) -> dict[str, Any]:
    """What the log says of an encode before its first frame."""
    frames = work.span if work.part is None else work.part
    return {
        "rig": str(work.rig.path),
        "layout": work.rig.layout,
        "cameras": [camera.name for camera in work.rig.cameras],
        "held_out": list(job.holdout),
        "excluded": list(job.exclude),
        "frames": [frames.start, frames.stop],
        "scale": job.scale,
        "held_out_sizes": ingest.held_out_sizes,
        "seed": job.seed,
        "keyframe": None if job.keyframe is None else str(job.keyframe),
        "resume": job.resume,
        "memory": work.memory.size,
        "settings": settings.as_document(),
    }


def _check_outputs(job: EncodeJob, stream: Path | BinaryIO, rig: Rig, mattes: Mattes | None) -> None:
    """Raises UsageError when the encode would write over something it reads, or twice into one file."""
    outputs = [Output("output", stream, grows=True, format=STREAM)]
    logs = {"log": job.log, "convergence_log": job.convergence_log}
    outputs += [Output(name, Path(path), format=JSON) for name, path in logs.items() if path is not None]
    check_outputs(outputs, files_of_job(job, rig, mattes))


def files_of_job(job: EncodeJob, rig: Rig, mattes: Mattes | None) -> list[tuple[Path, str]]:
    """Every file that an encode reads, and what it is called."""
    read = files_read(keyframe=job.keyframe, audio=job.audio)
    return [*files_of(rig), *files_of_mattes(mattes), *read]


def _base(settings: EncodeSettings, job: EncodeJob) -> Base | None:
    """The part that another one, of the frames ``only``, starts from; None where there is none."""
    if job.only is None:
        return None
    if not settings.closed:
        raise UsageError("`only`: parts are made of closed segments; add `segment` and `closed`")
    if job.resume:
        raise UsageError("`resume`: a part is encoded whole or not at all; drop `resume`")
    return None if job.keyframe is None or is_splat_file(job.keyframe) else read_base(Path(job.keyframe))


def source_of(job: EncodeJob) -> KeyframeSource | SplatSource | None:
    """The keyframe to begin with, if the job names one. Raises UsageError for what cannot be read."""
    if job.keyframe is None:
        return None
    return (
        read_splat_source(job.keyframe, job.max_memory) if is_splat_file(job.keyframe) else read_keyframe(job.keyframe)
    )


def chosen_settings(job: EncodeJob) -> EncodeSettings:
    """The settings with all that is asked for on top of them; raises UsageError for what cannot be."""
    chosen = preset(job.settings) if isinstance(job.settings, str) else job.settings
    if not isinstance(chosen, EncodeSettings):
        raise UsageError(f"`settings` {job.settings!r}: give the name of a preset, or EncodeSettings")
    for name, value, kind in (("switches", job.switches, Switches), ("targets", job.targets, Targets)):
        if not isinstance(value, (kind, type(None))):
            raise UsageError(f"`{name}` {value!r}: give {kind.__name__}, or None")
    if job.switches is not None:
        chosen = with_switches(chosen, job.switches)
    if job.segment is not None:
        if not (hasattr(job.segment, "__index__") and 1 <= job.segment <= MAX_FRAME):
            raise UsageError(f"`segment` {job.segment}: give a number of frames, at least 1 and at most {MAX_FRAME}")
        chosen = replace(chosen, segment=job.segment)
    chosen = chosen if job.targets is None else with_targets(chosen, job.targets)
    chosen = replace(chosen, closed=True) if job.closed else chosen
    check_together(chosen)
    return chosen


def wanted_effects(job: EncodeJob, settings: EncodeSettings) -> EffectChoice | None:
    """The choice of effects, "auto" for a named preset without one; None where the job's settings say it themselves."""
    effects = job.effects
    if effects is None and isinstance(job.settings, str) and not FRAME_METHODS.get(settings.method).dense:
        effects = "auto"
    if not isinstance(effects, (str, EffectChoice, type(None))):
        raise UsageError(f"`effects` {effects!r}: give an EffectChoice, or a text such as 'auto,-camera_shake'")
    return effect_choice(effects) if isinstance(effects, str) else effects


def _with_effects(
    settings: EncodeSettings,
    wanted: EffectChoice,
    job: EncodeJob,
    work: _Work,
    observer: EncodeObserver,
    warn: OnWarning,
    warned_frames: dict[str, set[int]],
) -> EncodeSettings:
    """The settings with the requested effects; the frames that a warning names go into ``warned_frames``, by camera."""
    require_sparse(settings, f"`effects` {wanted}", "has none of them")

    def decisions() -> Sequence[Decision]:
        if is_live(work.rig):
            return decided_beforehand(wanted, work.source.header if isinstance(work.source, KeyframeSource) else None)
        span = slice(work.span.start, work.span.stop)
        analysis = analyse(work.rig, frames=span, holdout=job.holdout, threads=job.threads, on_step=observer.look_step)
        for warning in analysis.check.warnings():
            warn(warning)
        faults = [fault for camera in analysis.check.cameras for fault in camera.faults]
        for fault in faults:
            warned_frames.setdefault(fault.camera, set()).update(fault.frames)
        if refused := [fault for fault in faults if fault.word in REFUSED]:
            raise RigError(f"{work.rig.path}: {refused[0]}")
        observer.looked({decision.effect: decision.cameras for decision in analysis.decisions if decision.detected})
        return analysis.decisions

    cameras = [camera.name for camera in work.rig.cameras if camera.name not in job.holdout]
    return with_effects(settings, wanted, cameras, decisions)
