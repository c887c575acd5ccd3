"""The analysis's command: decogs-analyze. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.cli.command_line import Parser, number_of_threads, print_text, progress, run, warn_as
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import (
    JSON,
    Output,
    check_folder_name,
    check_outputs,
    check_writable,
    is_device,
    write_whole,
)
from decogs.formats.files.unicode_forms import composed
from decogs.formats.frames.ranges import frame_range
from decogs.rig.mattes.options import add_matte_options, matte_choice
from decogs.rig.synchronisation.commands import add_sync_option, rig_in_step

_PAGE = "index.html"


def analyze_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-analyze``: the effects of a rig, a verdict on its cameras, and what to expect of it."""
    parser = analyze_parser()
    return run(parser, lambda: _analyze(parser, parser.parse_args(arguments)), extra="encode")


def analyze_parser() -> Parser:
    """The options of ``decogs-analyze``."""
    parser = Parser(
        prog="decogs-analyze",
        description="Analyse a rig before encoding: its effects with cameras, frames and cost, what is wrong with a "
        "camera, and what to expect of new views.",
        epilog="Pictures are downscaled, long clips subsampled to fit 256 MiB. Held-out cameras are excluded.",
    )
    parser.add_argument("rig_dir", help="the rig's folder, or one calibration file or folder inside it")
    parser.add_argument(
        "--holdout",
        action="append",
        default=[],
        type=composed,
        metavar="CAM",
        help="do not look at a camera (repeatable)",
    )
    parser.add_argument(
        "--exclude",
        action="append",
        default=[],
        type=composed,
        metavar="CAM",
        help="the same, as decogs-encode has it (repeatable)",
    )
    parser.add_argument("--frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3: (default: all)")
    parser.add_argument(
        "--json", metavar="FILE", help="write every figure, per camera and frame; - for stdout (the table: stderr)"
    )
    add_sync_option(parser)
    add_matte_options(parser.add_argument_group("subject alone"))
    parser.add_argument(
        "-o", "--output", metavar="DIR", help="write DIR/index.html: the rig's plan, its cameras, and what is wrong"
    )
    parser.add_argument(
        "--forecast",
        action="store_true",
        help="also say what an encode with each preset will take: bytes, processor time and quality, by a short encode",
    )
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_quiet()
    return parser


def _analyze(parser: Parser, options: argparse.Namespace) -> None:
    from decogs.formats.rigs import files_of, without_cameras
    from decogs.rig.check.mattes import check_mattes, lost_mattes
    from decogs.rig.mattes import files_of_mattes, open_mattes
    from decogs.rig.pictures.ingest import Ingest, frame_span

    from .analysis.analyse import analyse
    from .forecast.ladder import document as document_of
    from .forecast.ladder import table
    from .forecast.pilot import run_pilot
    from .job.job import EncodeJob
    from .output.progress import TerminalProgress

    rig = without_cameras(rig_in_step(options), options.exclude)
    for warning in rig.warnings:
        warn_as(parser)(warning)
    span = frame_span(rig, frame_range(options.frames))
    mattes = open_mattes(matte_choice(options), rig, span, options.holdout)
    if mattes is not None and mattes.cuts:
        ingest = Ingest(rig, holdout=options.holdout, mattes=mattes)
        agree = check_mattes(ingest, next(ingest.frames(span.start, span.start + 1)), warn_as(parser))
        print_text(agree, to_stderr=options.json == "-")
    to_file = options.json is not None and options.json != "-"
    page = None if options.output is None else Path(options.output) / _PAGE
    outputs = [Output("json", Path(options.json), grows=True, format=JSON)] if to_file else []
    outputs += [] if page is None else [Output("output", page, grows=True)]
    check_outputs(outputs, [*files_of(rig), *files_of_mattes(mattes)])
    if to_file and not is_device(Path(options.json)):
        check_writable(Path(options.json))
    if page is not None:
        check_folder_name(page.parent)
        _make_folder(page.parent)
    with progress("analysing", "step", quiet=options.quiet) as on_step:
        analysis = analyse(
            rig,
            frames=frame_range(options.frames),
            holdout=options.holdout,
            threads=options.threads,
            on_step=on_step,
            shown=True,
        )
    for warning in analysis.check.warnings():
        warn_as(parser)(warning)
    if mattes is not None and mattes.rig is not None and not mattes.is_own:  # whose pictures were read just now
        names, read = set(analysis.stats.names), analysis.stats.frames
        with progress("mattes", quiet=options.quiet) as on_frame:
            seen = range(read[0], read[-1] + 1, analysis.stats.step)
            for warning in lost_mattes(mattes, names, seen, on_frame):
                warn_as(parser)(warning)
    lines, found = [*analysis.table()], analysis.to_json()
    if options.forecast:
        job = EncodeJob(
            rig,
            "-",
            frames=slice(span.start, span.stop),
            holdout=options.holdout,
            mattes=matte_choice(options),
            threads=options.threads,
        )
        with TerminalProgress(None if options.quiet else sys.stderr) as observer:
            pilot = run_pilot(job, analysis.stats, observer)
        lines += ["", *table(pilot, len(span))]
        found["forecast"] = document_of(pilot, len(span))
    document = json.dumps(found, indent=1) + "\n"
    print_text("\n".join(lines), to_stderr=options.json == "-")
    if options.json == "-":
        print_text(document.rstrip("\n"))
    elif to_file:
        _write("--json", Path(options.json), document)
    if page is not None:
        from .analysis.page import page_of

        _write("--output", page, page_of(analysis))


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"--output {folder}: {error.strerror}; name a folder that can be made") from error
    check_writable(folder / _PAGE)


def _write(option: str, path: Path, document: str) -> None:
    try:
        if is_device(path):
            path.write_text(document, encoding="utf-8")
        else:
            write_whole(path, document.encode())
    except OSError as error:
        raise UsageError(f"{option} {path}: {error.strerror}; name a file in a folder that can be written") from error
