"""The encoder's command: decogs-encode. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from decogs.codec.header.profiles import PROFILES, Profile
from decogs.formats.cli.command_line import (
    INTERRUPTED,
    Parser,
    counted,
    in_option_names,
    number,
    number_of_bytes,
    number_of_threads,
    path_or_pipe,
    print_text,
    printable,
    progress,
    retryable,
    run,
    warn_as,
    whole_number,
)
from decogs.formats.cli.option_tables import words_of
from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.files.unicode_forms import composed
from decogs.formats.frames.ranges import frame_range
from decogs.formats.rigs.fields import read_toml
from decogs.rig.mattes.options import add_matte_options, matte_choice
from decogs.rig.synchronisation.commands import add_sync_option, rig_in_step

if TYPE_CHECKING:
    from decogs.decoder.editing.operations.base import Operation
    from decogs.formats.rigs import Rig

    from .job.job import EncodeJob
    from .output.observer import EncodeObserver


_NOT_CONFIGURED = ("output", "quiet", "help", "version", "config", "live")
"""What no take file says of an encode, by what options set."""


def encode_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-encode``: a rig folder to a .dgs stream."""
    parser = encode_parser()
    return run(parser, lambda: _encode_or_part(parser, encode_options(parser, arguments)), extra="encode")


def encode_options(parser: Parser, arguments: Sequence[str] | None) -> argparse.Namespace:
    """What is given, on top of what the take file that is named says of an encode."""
    options: argparse.Namespace = parser.parse_args(arguments)
    if options.config is None:
        return options
    path = Path(options.config)
    fields = read_toml(path).values
    table, rig = fields.get("encode", {}), fields.get("rig")
    if not isinstance(table, dict):
        raise UsageError(f"{path}: encode is no table")
    words = words_of(parser, table, f"{path}: [encode]", _NOT_CONFIGURED)
    given = list(sys.argv[1:] if arguments is None else arguments)
    if options.rig_dir is None and options.live is None and isinstance(rig, str):
        words.append(str(path.parent / rig))
    return argparse.Namespace(**vars(parser.parse_args([*words, *given])))


def encode_parser() -> Parser:
    """The options of ``decogs-encode``."""
    parser = Parser(
        prog="decogs-encode",
        description="Encode a rig of synchronised, calibrated cameras as a stream of 3D Gaussians.",
        epilog="Layouts: N3DV, MeetRoom, COLMAP, nerfstudio transforms.json, rig.json, more in docs/rig.md. "
        "Ctrl-C ends the stream early but whole. decogs-bench curve shows what accuracy costs in time, for your rig.",
    )
    parser.add_argument("rig_dir", nargs="?", help="the rig's folder, or one calibration file or folder inside it")
    parser.add_argument(
        "--live",
        metavar="FILE",
        help="instead of a rig: encode what cameras record while they do; FILE, in TOML, says where it comes from",
    )
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="SCENE.DGS",
        help="the stream to write, in place of one of that name; - for stdout",
    )
    parser.add_argument(
        "--config",
        metavar="TAKE.TOML",
        help="a take file, whose rig and [encode] count where nothing else is given (docs/takes.md)",
    )
    parser.add_quiet()
    _add_input(parser.add_argument_group("input"))
    add_matte_options(parser.add_argument_group("subject alone"))
    _add_quality(parser.add_argument_group("quality, size and time"))
    _add_effects(parser.add_argument_group("effects"))
    _add_long_takes(parser.add_argument_group("long takes"))
    _add_machine(parser.add_argument_group("machine"))
    _add_research(parser.add_argument_group("research"))
    return parser


def _add_input(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3: (default: all)")
    group.add_argument(
        "--scale", type=number, default=1.0, metavar="S", help="scale of the training pictures (default 1)"
    )
    group.add_argument(
        "--holdout",
        action="append",
        default=[],
        type=composed,
        metavar="CAM",
        help="keep a camera out of training (repeatable)",
    )
    group.add_argument(
        "--audio",
        metavar="A",
        help="sound for the stream: a camera's name, auto (the camera whose sound is clearest), a file, which begins "
        "with the rig's first frame, or none (default)",
    )
    add_sync_option(group)
    group.add_argument(
        "--exclude",
        action="append",
        default=[],
        type=composed,
        metavar="CAM",
        help="leave a camera out altogether, such as one that decogs-analyze calls harmful (repeatable)",
    )
    group.add_argument(
        "--keyframe",
        metavar="FILE",
        help="start from the keyframe of an earlier encode of this rig (.dgs), or from another trainer's Gaussians "
        "(.ply, .spz)",
    )


def _add_quality(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--preset",
        dest="settings",
        default="standard",
        metavar="P",
        help="live, draft, standard (default), high, archive; or paper",
    )
    group.add_argument(
        "--quality",
        type=number,
        metavar="Q",
        help="0 (smallest) to 100 (most exact), default 50: the preset. 16 points lower: twice the threshold and "
        "lambda, lattice steps 1.19 times as coarse, roughly .7 times the bytes (with --keyframe, the lattice is the "
        "keyframe's)",
    )
    group.add_argument("--lossless", action="store_true", help="code every change, exact to the lattice")
    group.add_argument(
        "--bitrate",
        type=number,
        metavar="KBIT",
        help="maximum mean bitrate of the frames after the first, at the rig's frame rate",
    )
    group.add_argument(
        "--max-mb-per-frame",
        type=number,
        metavar="MB",
        help="the same as a mean per frame, 1 MB = 1e6 bytes. Later keyframes count, the first does not",
    )
    group.add_argument(
        "--time-budget",
        metavar="T",
        help="maximum mean wall-clock time of the frames after the first (1.5s/frame, 500ms/frame or 1.5), from "
        "decoded pictures to the written packet. Training is shortened to fit, so the bytes depend on the machine; "
        "with --live, every n-th frame is encoded where cameras are faster",
    )
    group.add_argument(
        "--target-psnr",
        type=number,
        metavar="DB",
        help="early stopping: end a frame's training once the training views reach this PSNR in its regions of "
        "interest (the first frame: in the whole picture)",
    )


def _add_effects(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--effects",
        metavar="E",
        help="auto (default): analyse the rig as decogs-analyze does and enable the effects detected in it and in each "
        "frame; all; none; or names with commas; -NAME disables one: auto,-camera_shake, or --effects=-camera_shake",
    )


def _add_long_takes(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--segment",
        type=whole_number,
        metavar="N",
        help="insert a keyframe every N frames, for seeking (default: the first frame only)",
    )
    group.add_argument(
        "--closed",
        action="store_true",
        help="start every segment from the first keyframe's Gaussians, so that none depends on another",
    )
    group.add_argument(
        "--layers",
        action="store_true",
        help="write a base that plays alone, and what makes it whole: of the finished stream (decogs-edit layer), or "
        "as it grows with --live or into a pipe",
    )
    group.add_argument(
        "--profile",
        choices=list(PROFILES),
        metavar="PROFILE",
        help=f"for which players: {', '.join(PROFILES)}; bounds Gaussians, SH degree and bytes a second, with --layers "
        "the base's, and says so in the stream",
    )
    group.add_argument(
        "--resume", action="store_true", help="continue SCENE.DGS.part, or SCENE.DGS, of an interrupted encode"
    )
    group.add_argument(
        "--only",
        metavar="A:B",
        help="encode only frames A:B (whole segments) as a part for decogs-join, with --keyframe PART.DGS; A:A+1 of "
        "the first frame makes the part whose keyframe the others take. Exit code 75: try again",
    )
    group.add_argument(
        "--cluster",
        metavar="WHERE",
        help="encode segments side by side on a Ray cluster: local, or ray://HOST:PORT; with --segment and --closed",
    )
    group.add_argument(
        "--progress-lines",
        choices=["openjd"],
        metavar="KIND",
        help="print progress for a farm on stdout instead, as Open Job Description has it: openjd",
    )


def _add_machine(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    group.add_argument(
        "--device",
        default="auto",
        metavar="D",
        help="auto (default), cpu or cuda (by torch); auto is cpu",
    )
    group.add_argument(
        "--max-memory",
        type=number_of_bytes,
        metavar="SIZE",
        help="limit of memory for the encode, such as 512M or 6G (default: none); where it is tight, no frame is read "
        "ahead",
    )


def _add_research(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--method",
        metavar="M",
        help="decogs, paper (two stages with a cache), the bench's 3dgstream (the dense baseline, slower), or one of a "
        "package (default: the preset's)",
    )
    group.add_argument(
        "--ablate",
        default="",
        metavar="PARTS",
        help="parts of the method to leave out: select, focus, gate (with commas)",
    )
    group.add_argument(
        "--selection",
        metavar="RULE",
        help="selection rule: weight, paper, or one of an installed package (default: the preset's)",
    )
    group.add_argument(
        "--seed",
        type=whole_number,
        default=0,
        metavar="N",
        help="same seed, same bytes (default 0), except with --time-budget",
    )
    group.add_argument(
        "--metrics", action="store_true", help="put every frame's PSNR into the stream, for the player to show"
    )
    group.add_argument("--log", metavar="FILE", help="write each frame's figures as JSON lines")
    group.add_argument("--convergence-log", metavar="FILE", help="write the loss of every training step as JSON lines")


def _encode_or_part(parser: Parser, options: argparse.Namespace) -> int:
    operations = _finishing(options)
    if options.cluster is not None:
        code = _encode_on_cluster(parser, options)
    elif options.only is not None:
        return retryable(parser, lambda: _encode(parser, options))
    else:
        code = _encode(parser, options)
    # A recording is ended by Ctrl-C, so what it wrote is finished all the same.
    ended = code == 0 or (code == INTERRUPTED and options.live is not None)
    return code if operations is None or not ended else _finish(parser, options, operations) or code


def _finishing(options: argparse.Namespace) -> list[Operation] | None:
    """What is done to the finished stream, None for nothing. Raises UsageError for outputs that are never finished."""
    from decogs.decoder.editing.operations.layer import MakeLayers
    from decogs.decoder.editing.operations.profile import KeepProfile

    operations: dict[str, Operation] = {}
    if options.layers and not _layers_grow(options):
        operations["layers"] = MakeLayers()
    if options.profile is not None:
        operations["profile"] = KeepProfile(options.profile)
    for asked in operations:
        for name, value in {"only": options.only, "output": "-" if options.output == "-" else None}.items():
            if value is not None:
                raise UsageError(f"`{asked}`: needs a finished stream, so not with `{name}` {value}; use `edit`")
    # Layers that grew are measured: their header was written before they were known.
    is_measured = _layers_grow(options) and options.output != "-"
    return list(operations.values()) if operations or is_measured else None


def _layers_grow(options: argparse.Namespace) -> bool:
    """Whether layers are written while frames are encoded: where there is no finished stream yet, or none ever."""
    return options.layers and (options.live is not None or options.output == "-")


def _finish(parser: Parser, options: argparse.Namespace, operations: Sequence[Operation]) -> int:
    from .layering.finished import finish_stream

    with progress("finishing", quiet=options.quiet) as on_frame:
        report = finish_stream(
            options.output, operations, threads=options.threads, on_frame=on_frame, on_warning=warn_as(parser)
        )
    print_text("\n".join((*report.notes, f"{printable(options.output)}: finished, {report.file_bytes} bytes")))
    return 0


def _encode_on_cluster(parser: Parser, options: argparse.Namespace) -> int:
    from .cluster.encoding import encode_on_cluster

    _check_cluster(options)
    job, option_names = encode_job(options)
    with in_option_names(option_names), progress("encoding", quiet=options.quiet) as on_progress:
        report = encode_on_cluster(job, options.cluster, progress=on_progress, on_warning=warn_as(parser))
    parts, frames = counted(report.parts, "part"), counted(report.frames, "frame")
    print_text(f"{printable(options.output)}: {parts}, {frames}, {report.total_bytes} bytes")
    return 0


def _check_cluster(options: argparse.Namespace) -> None:
    """Raises UsageError for options that no cluster takes."""
    given = {"live": options.live, "only": options.only, "time_budget": options.time_budget, "log": options.log}
    given |= {"convergence_log": options.convergence_log, "output": "-" if options.output == "-" else None}
    given |= {"max_memory": options.max_memory, "progress_lines": options.progress_lines, "sync": options.sync}
    for name, value in given.items():
        if value is not None:
            raise UsageError(f"`cluster`: it does not go with `{name}` {value}; drop one of the two")


def encode_job(options: argparse.Namespace) -> tuple[EncodeJob, dict[str, str]]:
    """The job that the options ask for, and the options' names for what errors may name."""
    from .job.job import EncodeJob
    from .job.option_texts import names, seconds_per_frame
    from .job.switches import Switches
    from .job.targets import Targets

    rig, bytes_per_frame, option_names = _budget(options)
    seconds = None if options.time_budget is None else seconds_per_frame(options.time_budget)
    if seconds is not None:
        option_names[f"`time_budget` {seconds:g}"] = f"--time-budget {options.time_budget}"
    same = [
        "settings",
        "audio",
        "scale",
        "holdout",
        "exclude",
        "effects",
        "keyframe",
        "segment",
        "closed",
        "resume",
        "metrics",
    ]
    same += ["seed", "threads", "device", "max_memory", "log", "convergence_log"]
    job = EncodeJob(
        rig,
        path_or_pipe(options.output, "the stream"),
        frames=frame_range(options.frames),
        only=frame_range(options.only),
        mattes=matte_choice(options),
        switches=Switches(options.method, names(options.ablate), options.selection),
        targets=Targets(
            options.quality,
            bytes_per_frame,
            options.lossless,
            seconds,
            options.target_psnr,
            _profile_of_all(options),
        ),
        layers=_layers_grow(options),
        **{name: getattr(options, name) for name in same},
    )
    return job, option_names


def _encode(parser: Parser, options: argparse.Namespace) -> int:
    from .encoding import encode
    from .stream.summary import summary, warnings_of

    job, option_names = encode_job(options)
    with in_option_names(option_names), _observed(parser, options) as progress:
        report = encode(job, progress=progress, on_warning=warn_as(parser))
    print_text("\n".join(summary(report)), to_stderr=options.output == "-")
    for warning in warnings_of(report):
        warn_as(parser)(warning)
    return INTERRUPTED if report.interrupted else 0


@contextmanager
def _observed(parser: Parser, options: argparse.Namespace) -> Iterator[EncodeObserver]:
    """What shows the progress: lines for a farm, or for people."""
    from .output.open_job import OpenJobProgress
    from .output.progress import TerminalProgress

    if options.progress_lines is None:
        endless = options.live is not None and options.frames is None
        with TerminalProgress(None if options.quiet else sys.stderr, endless=endless) as bars:
            yield bars
        return
    if options.output == "-":
        raise UsageError("--progress-lines: standard output has the stream; name a file with --output")
    lines = OpenJobProgress(sys.stdout)
    try:
        yield lines
    except DecogsError as error:
        lines.failed(parser.in_options(str(error)))
        raise


def _rig(options: argparse.Namespace) -> Rig | str:
    """The rig's folder, or the rig whose cameras are recording, with the effects that frames decide for themselves."""
    from decogs.formats.rigs import open_live

    from .job.option_texts import seconds_per_frame
    from .settings.effects import PRESET_EFFECTS

    if (options.rig_dir is None) == (options.live is None):
        raise UsageError("give a rig's folder, or `live` and the file of the cameras that are recording")
    if options.live is None:
        return str(options.rig_dir) if options.sync is None else rig_in_step(options)
    for name in ("sync", "audio"):
        if getattr(options, name) is not None:
            raise UsageError(f"`live`: it does not go with `{name}` {getattr(options, name)}; drop one of the two")
    if options.effects is None:
        options.effects = ",".join(PRESET_EFFECTS)
    seconds = None if options.time_budget is None else seconds_per_frame(options.time_budget)
    return open_live(options.live, seconds_per_frame=seconds)


def _budget(options: argparse.Namespace) -> tuple[Rig | str, float | None, dict[str, str]]:
    """The rig, opened where a bitrate needs its frame rate or its starts matter, bytes per frame, and how these were
    asked for."""
    from decogs.formats.rigs import open_rig

    bitrate, megabytes, profile = options.bitrate, options.max_mb_per_frame, _profile_of_all(options)
    if bitrate is not None and megabytes is not None:
        raise UsageError("--bitrate and --max-mb-per-frame are one budget in two units; drop one of the two")
    given = _rig(options)
    if bitrate is not None:
        rig = open_rig(given) if isinstance(given, str) else given
        if rig.fps is None:
            raise UsageError(f"--bitrate: {rig.path} states no frame rate; use --max-mb-per-frame")
        return rig, *_asked(bitrate * 1000 / 8 / rig.fps, "--bitrate", bitrate)
    if profile is not None and megabytes is None and not options.lossless:
        rig = open_rig(given) if isinstance(given, str) else given
        if rig.fps is None:
            raise UsageError(f"`profile` {profile.name}: {rig.path} states no frame rate, so none a second")
        return rig, *_asked(profile.bytes_per_second / rig.fps, "--profile", profile.name)
    if megabytes is not None:
        return given, *_asked(megabytes * 1e6, "--max-mb-per-frame", megabytes)
    return given, None, {"`bytes_per_frame`": "--max-mb-per-frame or --bitrate"}


def _profile_of_all(options: argparse.Namespace) -> Profile | None:
    """The profile that bounds the whole scene: in layers, it bounds the base."""
    return None if options.profile is None or options.layers else PROFILES[options.profile]


def _asked(bytes_per_frame: float, option: str, value: float | str) -> tuple[float, dict[str, str]]:
    text = value if isinstance(value, str) else f"{value:g}"
    option_names = {f"`bytes_per_frame` {bytes_per_frame:g}": f"{option} {text}", "`bytes_per_frame`": option}
    return bytes_per_frame, option_names
