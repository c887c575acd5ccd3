"""A rig in, a stream out: what ``decogs-encode`` does."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from decogs.formats.callbacks import OnWarning
from decogs.formats.container import MAX_FRAME
from decogs.formats.errors import UsageError
from decogs.formats.frame_ranges import Frames
from decogs.formats.outputs import Output, check_outputs
from decogs.formats.rigs import Rig, files_of, open_rig
from decogs.formats.threads import thread_count

from .analysis import Decision, EffectChoice, effect_choice, with_effects
from .analysis.analyse import analyse
from .backends import check_device
from .input.imported_keyframe import KeyframeSource, read_keyframe
from .input.imported_splats import SplatSource, is_splat_file, read_splat_source
from .input.ingest import Ingest, frame_span
from .memory_limit import memory_within
from .output.convergence_log import ConvergenceLog
from .output.encode_log import EncodeLog
from .output.observer import EncodeObserver, Observers
from .output.reports import EncodeReport
from .output.stream_output import open_output
from .parts.base import Base, read_base
from .parts.encoding import encode_part
from .parts.manifest import part_frames
from .parts.output import open_part
from .settings.compensation import CorrectionSettings
from .settings.encode import EncodeSettings
from .settings.presets import preset
from .stream.run import encode_stream
from .switches import Switches, check_together, with_switches
from .targets import Targets, with_targets
from .training.methods import FRAME_METHODS, require_sparse

_Source = KeyframeSource | SplatSource


def encode(
    rig: str | os.PathLike[str] | Rig,
    output: str | os.PathLike[str] | BinaryIO,
    settings: str | EncodeSettings = "standard",
    *,
    frames: Frames = None,
    scale: float = 1.0,
    holdout: Sequence[str] = (),
    switches: Switches | None = None,
    targets: Targets | None = None,
    effects: EffectChoice | str | None = None,
    corrections: CorrectionSettings | None = None,
    keyframe: str | os.PathLike[str] | None = None,
    segment: int | None = None,
    closed: bool = False,
    only: Frames = None,
    resume: bool = False,
    metrics: bool = False,
    seed: int = 0,
    threads: int = 0,
    device: str = "auto",
    max_memory: int | None = None,
    log: str | os.PathLike[str] | None = None,
    convergence_log: str | os.PathLike[str] | None = None,
    progress: EncodeObserver | None = None,
    on_warning: OnWarning | None = None,
) -> EncodeReport:
    """Encodes a rig of synchronised, calibrated cameras as a .dgs stream.

    ``rig``: its folder or calibration file, or the rig itself. ``output``: the file to write, or an open one that takes
    bytes, such as a pipe. No file of the rig, nor the one of ``keyframe``, is ever written over; an output that another
    encode writes, or has left unfinished, is refused. ``settings``: a name in PRESETS, or settings.

    Input: ``frames``: consecutive ones, as a slice or a range; all when None. ``scale``: of the pictures
    trained on, above 0 and at most 4. ``holdout``: names of cameras kept out of training and measured on.

    Method: ``switches``: the method of later frames and its parts; ``targets``: quality, bytes and time; both on
    top of the settings. ``effects``: those to enable, as `EffectChoice` or as a text (`effect_choice`), such as
    "auto,-camera_shake"; None is "auto" for a named preset, and for settings what they say; the baseline has none.
    ``corrections``: cameras whose drift is known, instead of those that ``effects`` detects. ``keyframe``: an
    earlier stream of the same rig, first frame and held-out cameras whose keyframe is taken as it is; or another
    trainer's .ply or .spz. ``segment``: frames from one keyframe to the next; later ones are coded as differences
    from the first. ``closed``: every such segment starts from the first keyframe's Gaussians and depends on no
    other (`closed_segments`). ``only``: the frames of the rig to encode of all ``frames``, whole closed segments or
    the first frame alone: the output is then a part, for `join`. Parts but the first take the keyframe from another
    part, as ``keyframe``. ``resume``: go on with what an encode with the same options left in ``output`` + ".part",
    or as a shorter stream; the file gets the bytes of one that was not cut off.

    ``metrics``: the stream tells the PSNR of every frame, which the player shows; not with ``resume``.

    Resources: ``seed``: the same one gives the same bytes, except with a time budget. ``threads``: 0 means all
    processors; the stream does not depend on it. ``device``: "cuda" takes gsplat and gives other bits every time;
    "auto" is the CPU. ``max_memory``: bytes that the encode may take beyond the program itself (`memory_limit`); one
    that may take more does not read the next frame ahead, or is refused before it starts. None is no limit.

    Reports: ``log``: file for JSON lines. ``convergence_log``: file for the loss of every training step, as JSON
    lines; with ``resume``, both are continued. ``progress`` observes every step and frame. ``on_warning`` is called
    as soon as something is found that the user should know of the rig, and of a stream or keyframe that does not show
    its pictures.

    Ctrl-C after the first frame ends the stream early but whole. Raises RigError, UsageError, StreamError for a damaged
    ``keyframe``, or TrainingError; nothing is then left under the output's name.
    """
    check_device(device)
    if metrics and resume:
        raise UsageError("`metrics` cannot be resumed: what was left may lack them; leave out one of the two")
    if not (isinstance(seed, int) and seed >= 0):
        raise UsageError(f"`seed` {seed}: give a number of at least 0, a whole one")
    chosen = chosen_settings(settings, switches, targets, segment, closed=closed)
    base = _base(chosen, only, keyframe, resume=resume)
    source = None if keyframe is None or base is not None else _read_source(keyframe, max_memory)
    if not isinstance(rig, Rig):
        rig = open_rig(rig)
    warn = on_warning or (lambda text: None)
    for warning in rig.warnings:
        warn(warning)
    span = frame_span(rig, frames)
    part = None if only is None else part_frames(only, span, chosen.segment)
    wanted = wanted_effects(effects, settings, chosen.method)
    ingest = Ingest(rig, holdout=holdout, scale=scale)
    stream = Path(output) if isinstance(output, (str, os.PathLike)) else output
    log, convergence_log = (None if path is None else Path(path) for path in (log, convergence_log))
    _check_outputs(stream, log, convergence_log, rig, None if base is None and source is None else keyframe)
    taken = source if base is None else base.source
    memory = memory_within(
        ingest,
        chosen,
        max_memory,
        gaussians=0 if taken is None else taken.count,
        frames=len(span),
        threads=thread_count(threads),
    )
    with ExitStack() as open_files:
        taken_output = open_output(stream, resume=resume) if part is None else open_part(stream)
        target = open_files.enter_context(taken_output)
        observers = [] if log is None else [open_files.enter_context(EncodeLog(log, append=resume))]
        curve = None
        if convergence_log is not None:
            curve = open_files.enter_context(ConvergenceLog(convergence_log, append=resume))
        observer = Observers([*observers, *([] if progress is None else [progress])])
        if base is not None:
            asked = chosen if corrections is None else replace(chosen, corrections=corrections)
            chosen = base.settings(asked, wanted)
        elif wanted is not None:
            chosen = _with_effects(
                chosen, wanted, rig, holdout=holdout, span=span, threads=threads, observer=observer, warn=warn
            )
        if corrections is not None and base is None:
            chosen = replace(chosen, corrections=corrections)
        if chosen.corrections.lens:
            ingest = Ingest(rig, holdout=holdout, scale=scale, lens=chosen.corrections.lens)
        observer.started(
            {
                "rig": str(rig.path),
                "layout": rig.layout,
                "cameras": [camera.name for camera in rig.cameras],
                "held_out": list(holdout),
                "frames": [span.start, span.stop] if part is None else [part.start, part.stop],
                "scale": scale,
                "held_out_sizes": ingest.held_out_sizes,
                "seed": seed,
                "keyframe": None if keyframe is None else str(keyframe),
                "resume": resume,
                "memory": memory.size,
                "settings": chosen.as_document(),
            }
        )
        given: dict[str, Any] = {
            "seed": seed,
            "threads": thread_count(threads),
            "keyframe": source,
            "device": device,
            "metrics": metrics,
            "read_ahead": memory.reads_ahead,
            "on_frame": observer.frame,
            "on_keyframe_step": observer.keyframe_step,
            "convergence": curve,
            "on_warning": warn,
        }
        if part is None:
            report = encode_stream(ingest, target, span, chosen, resume=resume, **given)
        else:
            report = encode_part(ingest, target, part, span, chosen, base=base, **given)
        report = replace(report, held_out_sizes=ingest.held_out_sizes)
        observer.finished(
            {
                "output": str(report.output),
                "bytes": report.total_bytes,
                "interrupted": report.interrupted,
                "resumed": report.resumed,
            }
        )
    return report


def _check_outputs(
    stream: Path | BinaryIO,
    log: Path | None,
    convergence_log: Path | None,
    rig: Rig,
    keyframe: str | os.PathLike[str] | None,
) -> None:
    """Raises UsageError when the encode would write over something it reads, or twice into one file."""
    outputs = [Output("output", stream, grows=True)]
    logs = {"log": log, "convergence_log": convergence_log}
    outputs += [Output(name, path) for name, path in logs.items() if path is not None]
    read = [] if keyframe is None else [(Path(keyframe), "is read, as `keyframe`")]
    check_outputs(outputs, [*files_of(rig), *read])


def _base(
    settings: EncodeSettings, only: Frames, keyframe: str | os.PathLike[str] | None, *, resume: bool
) -> Base | None:
    """The part that another one, of the frames ``only``, starts from; None where there is none."""
    if only is None:
        return None
    if not settings.closed:
        raise UsageError("`only`: parts are made of closed segments; add `segment` and `closed`")
    if resume:
        raise UsageError("`resume`: a part is encoded whole or not at all; drop `resume`")
    return None if keyframe is None or is_splat_file(keyframe) else read_base(Path(keyframe))


def _read_source(path: str | os.PathLike[str], max_memory: int | None) -> _Source:
    return read_splat_source(path, max_memory) if is_splat_file(path) else read_keyframe(path)


def chosen_settings(
    settings: str | EncodeSettings,
    switches: Switches | None,
    targets: Targets | None,
    segment: int | None,
    *,
    closed: bool,
) -> EncodeSettings:
    """The settings with all that is asked for on top of them; raises UsageError for what cannot be."""
    chosen = preset(settings) if isinstance(settings, str) else settings
    if not isinstance(chosen, EncodeSettings):
        raise UsageError(f"`settings` {settings!r}: give the name of a preset, or EncodeSettings")
    for name, value, kind in (("switches", switches, Switches), ("targets", targets, Targets)):
        if not isinstance(value, (kind, type(None))):
            raise UsageError(f"`{name}` {value!r}: give {kind.__name__}, or None")
    if switches is not None:
        chosen = with_switches(chosen, switches)
    if segment is not None:
        if not (hasattr(segment, "__index__") and 1 <= segment <= MAX_FRAME):
            raise UsageError(f"`segment` {segment}: give a number of frames, at least 1 and at most {MAX_FRAME}")
        chosen = replace(chosen, segment=segment)
    chosen = chosen if targets is None else with_targets(chosen, targets)
    chosen = replace(chosen, closed=True) if closed else chosen
    check_together(chosen)
    return chosen


def wanted_effects(
    effects: EffectChoice | str | None, settings: str | EncodeSettings, method: str
) -> EffectChoice | None:
    """The choice of effects, "auto" for a named preset without one; None where ``settings`` say it themselves."""
    if effects is None and isinstance(settings, str) and not FRAME_METHODS.get(method).dense:
        effects = "auto"
    if not isinstance(effects, (str, EffectChoice, type(None))):
        raise UsageError(f"`effects` {effects!r}: give an EffectChoice, or a text such as 'auto,-camera_shake'")
    return effect_choice(effects) if isinstance(effects, str) else effects


def _with_effects(
    settings: EncodeSettings,
    wanted: EffectChoice,
    rig: Rig,
    *,
    holdout: Sequence[str],
    span: range,
    threads: int,
    observer: EncodeObserver,
    warn: OnWarning,
) -> EncodeSettings:
    """The settings with the requested effects, for which the rig may have to be analysed."""
    require_sparse(settings, f"`effects` {wanted}", "has none of them")

    def decisions() -> Sequence[Decision]:
        look = slice(span.start, span.stop)
        found = analyse(rig, frames=look, holdout=holdout, threads=threads, on_step=observer.look_step)
        for warning in found.check.warnings():
            warn(warning)
        observer.looked({decision.effect: decision.cameras for decision in found.decisions if decision.detected})
        return found.decisions

    cameras = [camera.name for camera in rig.cameras if camera.name not in holdout]
    return with_effects(settings, wanted, cameras, decisions)
