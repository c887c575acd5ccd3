"""decogs-make: takes brought up to date. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.cli.command_line import (
    USER_ERROR,
    Parser,
    in_option_names,
    number_of_threads,
    print_text,
    printable,
    progress,
    run,
    size_text,
    warn_as,
    whole_number,
)
from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.frames.ranges import frames_text
from decogs.rig.synchronisation.commands import add_sync_option, rig_in_step


def make_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-make``: take files to all that they deliver."""
    parser = make_parser()
    return run(parser, lambda: _make(parser.parse_args(arguments)), extra="encode")


def make_parser() -> Parser:
    """The options of ``decogs-make``."""
    parser = Parser(
        prog="decogs-make",
        description="Bring what takes deliver up to date: encode, edit and write what would be another now.",
        epilog="docs/takes.md describes take files. What this has not made is never replaced.",
    )
    parser.add_argument(
        "takes", nargs="+", metavar="TAKE.TOML", help="take files; paths in them count from their folders"
    )
    parser.add_argument(
        "--new", metavar="RIG_DIR", help="write TAKE.TOML, a first one for a rig or for a folder of videos"
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would be done, and why")
    parser.add_argument(
        "--forecast",
        action="store_true",
        help="with --dry-run, also what the encode will take, by a short one (decogs-analyze --forecast)",
    )
    parser.add_argument(
        "-j", "--jobs", type=number_of_threads, default=1, metavar="N", help="steps at a time (default 1)"
    )
    parser.add_argument(
        "--threads",
        type=number_of_threads,
        default=0,
        metavar="N",
        help="of all steps that are done at a time, where a take does not say (default: all processors for each)",
    )
    parser.add_quiet()
    return parser


def _make(options: argparse.Namespace) -> int:
    from .forecast import forecast
    from .making import Making, check_apart
    from .take_file import read_take

    if options.forecast and not options.dry_run:
        raise UsageError("`forecast`: goes with `dry_run`")
    paths = [Path(name) for name in options.takes]
    if options.new is not None:
        return _new(paths, Path(options.new), quiet=options.quiet)
    takes = [read_take(path) for path in paths]
    check_apart(takes)
    failed = False
    rows: list[tuple[str, ...]] = []
    told: list[str] = []
    for take in takes:
        try:
            making = Making(
                take,
                _quiet if options.quiet else _told,
                threads=options.threads and max(1, options.threads // options.jobs),
                quiet=options.quiet,
            )
            outcomes = making.plan() if options.dry_run else making.make(options.jobs)
        except DecogsError as error:
            print_text(f"{printable(str(take.path))}: {error}", to_stderr=True)
            failed = True
            continue
        for outcome in outcomes:
            failed |= outcome.is_bad
            rows.append((str(take.path), *outcome.row(size_text)))
            if options.dry_run and outcome.why:
                rows.append(("", "", f"$ {outcome.step.text}"))
        if options.forecast:
            told += ["", f"{printable(str(take.path))}:", *forecast(take, shown=not options.quiet)]
    print_text("\n".join([*_table(rows), *told]))
    return USER_ERROR if failed else 0


def _told(line: str) -> None:
    print_text(line, to_stderr=True)


def _quiet(line: str) -> None:
    """Nobody asked."""


def _new(paths: Sequence[Path], rig_dir: Path, *, quiet: bool) -> int:
    from .new_take import new_take
    from .take_file import read_take

    if len(paths) != 1:
        raise UsageError("`new`: one take file is written at a time; name one")
    (path,) = paths
    if path.exists():
        raise UsageError(f"{path}: is there already; name another file")
    with progress("analysing", "step", quiet=quiet) as on_step:
        text = new_take(rig_dir, path.parent, on_step)
    with path.open("x", encoding="utf-8") as file:
        file.write(text)
    read_take(path)
    print_text(f"{printable(str(path))}: written; edit it, then: decogs-make {printable(str(path))}")
    return 0


def _table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows in columns, but for the last cells, which are as long as they like."""
    widths = [max((len(row[column]) for row in rows if len(row) > column + 1), default=0) for column in range(5)]
    return [
        "  ".join([*(cell.ljust(w) for cell, w in zip(row[:-1], widths, strict=False)), row[-1]]).rstrip()
        for row in rows
    ]


def report_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-report``: a stream beside what was recorded, as one page."""
    parser = report_parser()
    return run(parser, lambda: _report(parser.parse_args(arguments)), extra="encode")


def report_parser() -> Parser:
    """The options of ``decogs-report``."""
    parser = Parser(
        prog="decogs-report",
        description="Write a page for whoever gets a stream: how it looks, and how far it is from what was recorded.",
        epilog="The page needs no other file and no network.",
    )
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument(
        "-o",
        "--output",
        required=True,
        metavar="REPORT.HTML",
        help="the page to write; a name that ends in "
        ".json: only its map of where the scene holds, the player's `fence`",
    )
    parser.add_argument("--rig", dest="rig_dir", required=True, metavar="RIG_DIR", help="the rig it was encoded from")
    add_sync_option(parser)
    parser.add_argument(
        "--against", metavar="OTHER.DGS", help="another stream of the rig's frames: where this one is nearer to them"
    )
    parser.add_argument("--log", metavar="FILE", help="that decogs-encode --log wrote: the page says what it took")
    parser.add_argument("--title", metavar="TEXT", help="of the page (default: the stream's, or its file's name)")
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_quiet()
    return parser


def _report(options: argparse.Namespace) -> None:
    from decogs.decoder.reading.stream import open_stream
    from decogs.formats.files.outputs import Output, check_outputs, files_read, write_whole

    from .report import Extras, fence, report
    from .spent import read_spent

    output, stream = Path(options.output), Path(options.stream)
    is_fence = output.suffix.lower() == ".json"
    if is_fence:
        _check_fence(options)
    check_outputs([Output("output", output)], files_read(stream=stream, log=options.log, against=options.against))
    with open_stream(stream) as opened:
        title = options.title or opened.header.presentation.title or stream.stem
    extras = Extras(
        None if options.log is None else read_spent(Path(options.log)),
        None if options.against is None else Path(options.against),
    )
    rig = rig_in_step(options)
    with progress("comparing", quiet=options.quiet) as on_frame:
        if is_fence:
            text = fence(stream, rig, on_frame, options.threads)
        else:
            text = report(stream, rig, title, on_frame, options.threads, extras)
    write_whole(output, text.encode())
    print_text(f"{printable(str(output))}: {size_text(len(text))}")


def _check_fence(options: argparse.Namespace) -> None:
    """The map has no place for what pages say: better no file than one without what was asked for."""
    given = [f"`{name}`" for name in ("against", "log", "title") if getattr(options, name) is not None]
    if given:
        raise UsageError(f"{', '.join(given)}: for a page; leave out with an `output` that ends in .json")


def verify_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-verify``: whether a stream is what its footage and settings give."""
    parser = verify_parser()
    return run(parser, lambda: _verify(parser, parser.parse_args(arguments)), extra="encode")


def verify_parser() -> Parser:
    """The options of ``decogs-verify``."""
    parser = Parser(
        prog="decogs-verify",
        description="Encode some of a stream again, and compare it byte for byte: the closed segment of a frame, or "
        "the first three frames. Exit code 1 where anything is another.",
        epilog="The same on any x86-64 processor that decodes the videos alike, with the same packages; SPEC.md, "
        '"Exactness", says what may differ elsewhere.',
    )
    parser.add_argument("--frame", type=whole_number, default=0, metavar="N", help="of a stream of closed segments")
    parser.add_argument(
        "--log", metavar="FILE", help="that decogs-encode --log wrote: says whose pictures are others in later frames"
    )
    parser.add_quiet()
    parser.add_argument("stream", help="the .dgs file, as decogs-encode wrote it")
    parser.add_argument(
        "encode",
        nargs=argparse.REMAINDER,
        metavar="RIG_DIR OPTION ...",
        help="rig and options as decogs-encode was given them, without -o; or --config TAKE.TOML",
    )
    return parser


def _verify(parser: Parser, options: argparse.Namespace) -> int:
    from decogs.encoder.commands import encode_job, encode_options, encode_parser
    from decogs.encoder.output.progress import TerminalProgress

    from .encode_log import recorded_of
    from .verifying import verify

    asked = encode_options(encode_parser(), [*options.encode, "-o", f"{options.stream}.again"])
    job, option_names = encode_job(asked)
    with in_option_names(option_names), TerminalProgress(None if options.quiet else sys.stderr) as observer:
        recorded = None if options.log is None else recorded_of(Path(options.log))
        verdict = verify(Path(options.stream), job, options.frame, observer, warn_as(parser), recorded)
    frames = frames_text(verdict.frames)
    if not verdict.differences:
        print_text(f"{printable(options.stream)}: {frames} are the same bytes, encoded again")
        return 0
    for difference in verdict.differences:
        print_text(f"{printable(options.stream)}: {difference}")
    return 1
