"""The analysis's command: decogs-analyze. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.command_line import Parser, number_of_threads, print_text, progress, run, warn_as
from decogs.formats.errors import UsageError
from decogs.formats.frame_ranges import frame_range
from decogs.formats.outputs import Output, check_outputs, check_writable, is_device, write_whole
from decogs.formats.rigs import files_of

from ..input.ingest import Ingest, frame_span
from ..input.matte_checks import check_mattes
from ..input.mattes import open_mattes
from ..input.mattes.options import add_matte_options, matte_choice
from ..synchronisation.commands import add_sync_option, rig_in_step


def analyze_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-analyze``: the effects of a rig, and what to expect of it."""
    parser = analyze_parser()
    return run(parser, lambda: _analyze(parser, parser.parse_args(arguments)))


def analyze_parser() -> Parser:
    """The options of ``decogs-analyze``."""
    parser = Parser(
        prog="decogs-analyze",
        description="Analyse a rig before encoding: its effects with cameras, frames and cost, and its coverage.",
        epilog="Pictures are downscaled, long clips subsampled to fit 256 MiB. Held-out cameras are excluded.",
    )
    parser.add_argument("rig_dir", help="the rig's folder, or one calibration file or folder inside it")
    parser.add_argument("--holdout", action="append", default=[], metavar="CAM", help="exclude a camera (repeatable)")
    parser.add_argument("--frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3: (default: all)")
    parser.add_argument(
        "--json", metavar="FILE", help="write every figure, per camera and frame; - for stdout (the table: stderr)"
    )
    add_sync_option(parser)
    add_matte_options(parser.add_argument_group("subject alone"))
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_quiet()
    return parser


def _analyze(parser: Parser, options: argparse.Namespace) -> None:
    from .analyse import analyse

    rig = rig_in_step(options)
    for warning in rig.warnings:
        warn_as(parser)(warning)
    span = frame_span(rig, frame_range(options.frames))
    mattes = open_mattes(matte_choice(options), rig, span, options.holdout)
    if mattes is not None and mattes.cuts:
        ingest = Ingest(rig, holdout=options.holdout, mattes=mattes)
        check_mattes(ingest, next(ingest.frames(span.start, span.start + 1)), warn_as(parser))
    to_file = options.json is not None and options.json != "-"
    if to_file:
        check_outputs([Output("json", Path(options.json), grows=True)], files_of(rig))
        if not is_device(Path(options.json)):
            check_writable(Path(options.json))
    with progress("analysing", "step", quiet=options.quiet) as on_step:
        analysis = analyse(
            rig,
            frames=frame_range(options.frames),
            holdout=options.holdout,
            threads=options.threads,
            on_step=on_step,
        )
    for warning in analysis.check.warnings():
        warn_as(parser)(warning)
    document = json.dumps(analysis.to_json(), indent=1) + "\n"
    print_text("\n".join(analysis.table()), to_stderr=options.json == "-")
    if options.json == "-":
        print_text(document.rstrip("\n"))
    elif to_file:
        _write(Path(options.json), document)


def _write(path: Path, document: str) -> None:
    try:
        if is_device(path):
            path.write_text(document, encoding="utf-8")
        else:
            write_whole(path, document.encode())
    except OSError as error:
        raise UsageError(f"--json {path}: {error.strerror}; name a file in a folder that can be written") from error
