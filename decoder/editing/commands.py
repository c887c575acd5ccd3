"""The command decogs-edit. Only arguments and what is printed; the work is done by ``decogs.decoder.editing.edit``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from decogs.formats.cli.command_line import (
    Parser,
    counted,
    number_of_bytes,
    number_of_threads,
    path_or_pipe,
    print_text,
    printable,
    progress,
    run,
    size_text,
    warn_as,
)
from decogs.formats.errors import UsageError

from ..commands import whole_file
from ..limits import DEFAULT_MAX_MEMORY
from .operations import OPERATIONS


def edit_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-edit``: a stream cut, cropped, joined, turned and graded, without training."""
    parser = edit_parser()
    return run(parser, lambda: _edit(parser, sys.argv[1:] if arguments is None else arguments), cleans_up=True)


def edit_parser() -> Parser:
    """The options of ``decogs-edit``."""
    listed = "; ".join(f"{name}: {operation.summary}" for name, operation in OPERATIONS.items())
    parser = Parser(
        prog="decogs-edit",
        description="Edit a .dgs stream without training; what an operation does not touch keeps its bits.",
        epilog=f"Operations, run in the order given: {listed}. decogs-edit OPERATION --help shows what follows its "
        "name; docs/edit.md has pictures.",
    )
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument("operations", nargs="*", default=[], metavar="OPERATION", help="what to do")
    parser.add_argument("-o", "--output", metavar="OUT.DGS", help="the stream to write; - for stdout")
    parser.add_argument(
        "--recipe", metavar="FILE", help='operations from a TOML file, before those given: operations = ["trim 0:48"]'
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would change")
    parser.add_argument(
        "--max-memory",
        type=number_of_bytes,
        default=DEFAULT_MAX_MEMORY,
        metavar="SIZE",
        help="limit of memory for a stream, such as 512M or 2G (default 4G)",
    )
    parser.add_argument(
        "--threads",
        type=number_of_threads,
        default=0,
        metavar="N",
        help="of what an operation trains (default: all processors)",
    )
    parser.add_quiet()
    return parser


def _edit(parser: Parser, words: Sequence[str]) -> None:
    from .editing import edit
    from .recipe import operation_parser, parse_operations, split_arguments

    if len(words) == 2 and words[0] in OPERATIONS and words[1] in ("-h", "--help"):
        operation_parser(words[0]).parse_args(words[1:])
    own, asked = split_arguments(words, parser)
    options = parser.parse_args(own)
    if options.operations:
        raise UsageError(f"{options.operations[0]}: there is no such operation; choose from {', '.join(OPERATIONS)}")
    if (options.output is None) != options.dry_run:
        wrong = "`dry_run` writes nothing; leave out `output`" if options.dry_run else "name what to write by `output`"
        raise UsageError(wrong)
    operations = parse_operations(asked)
    if not operations and options.recipe is None:
        raise UsageError("no operation is given; decogs-edit --help lists them")
    output = None if options.output is None else path_or_pipe(options.output, "the stream")
    with progress("editing", quiet=options.quiet) as on_frame:
        report = edit(
            whole_file(options.stream),
            output,
            operations,
            recipe=options.recipe,
            max_memory=options.max_memory,
            threads=options.threads,
            on_frame=on_frame,
            on_warning=warn_as(parser),
        )
    named = "would be written" if output is None else printable(options.output)
    kept = f"{counted(report.kept_packets, 'packet')} as before"
    lines = [*report.notes, f"{named}: {counted(report.frame_count, 'frame')}, {size_text(report.file_bytes)}, {kept}"]
    print_text("\n".join(map(printable, lines)), to_stderr=options.output == "-")
