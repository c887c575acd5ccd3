"""The command of parts: decogs-join. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from decogs.formats.cli.command_line import Parser, counted, path_or_pipe, print_text, printable, progress, run


def join_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-join``: parts that ``decogs-encode --only`` made to one .dgs stream."""
    parser = join_parser()
    return run(parser, lambda: _join(parser.parse_args(arguments)), cleans_up=True, extra="encode")


def join_parser() -> Parser:
    """The options of ``decogs-join``."""
    parser = Parser(
        prog="decogs-join",
        description="Join the parts of a take to the stream that an encode in one go would have written.",
    )
    parser.add_argument("parts", nargs="+", metavar="PART.DGS", help="all parts of the take, in any order")
    parser.add_argument("-o", "--output", required=True, metavar="SCENE.DGS", help="the stream to write; - for stdout")
    parser.add_quiet()
    return parser


def _join(options: argparse.Namespace) -> int:
    from .joining import join

    with progress("joining", quiet=options.quiet) as on_frame:
        report = join(options.parts, path_or_pipe(options.output, "the stream"), on_frame=on_frame)
    parts, frames = counted(report.parts, "part"), counted(report.frames, "frame")
    print_text(
        f"{printable(options.output)}: {parts}, {frames}, {report.total_bytes} bytes", to_stderr=options.output == "-"
    )
    return 0
