"""The synchronisation's command: decogs-sync. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from decogs.formats.cli.command_line import Parser, number_of_threads, print_text, progress, run, warn_as
from decogs.formats.files.outputs import staged_files

if TYPE_CHECKING:
    from decogs.formats.rigs import Rig

    from .starts import Synchrony


def sync_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-sync``: a rig out of step to one that states when its cameras start."""
    parser = sync_parser()
    return run(parser, lambda: _sync(parser, parser.parse_args(arguments)), cleans_up=True, extra="encode")


def sync_parser() -> Parser:
    """The options of ``decogs-sync``."""
    parser = Parser(
        prog="decogs-sync",
        description="Find out when each camera of a rig started to record: by timecode, else by sound, else by what "
        "moves.",
        epilog="RIG2 holds rig.json with every camera's start, sync.json, and links to the videos.",
    )
    parser.add_argument("rig_dir", help="the rig's folder, or one calibration file or folder inside it")
    parser.add_argument("-o", "--output", required=True, metavar="RIG2", help="the folder to write; a new one")
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_quiet()
    return parser


def add_sync_option(group: argparse._ArgumentGroup | argparse.ArgumentParser) -> None:
    """``--sync``, of every command that reads a rig."""
    group.add_argument(
        "--sync",
        metavar="S",
        help="auto: find out when each camera started, as decogs-sync does; or a sync.json (default: as the rig's "
        "calibration says, else all at once)",
    )


def rig_in_step(options: argparse.Namespace) -> Rig:
    """The rig that the options ask for, in step."""
    from .opening import AUTO, open_synchronised

    quiet = options.quiet or options.sync != AUTO
    with progress("synchronising", "step", quiet=quiet) as on_step:
        return open_synchronised(options.rig_dir, options.sync, threads=options.threads, on_step=on_step)


def _sync(parser: Parser, options: argparse.Namespace) -> None:
    from decogs.formats.rigs import in_step, open_recordings
    from decogs.formats.rigs.rig_folder import check_new_folder, write_rig_folder

    from .starts import find_starts
    from .sync_file import NAME, sync_document

    folder = Path(options.output)
    check_new_folder(folder)
    rig = open_recordings(options.rig_dir)
    with progress("synchronising", "step", quiet=options.quiet) as on_step:
        synchrony = find_starts(rig, threads=options.threads, on_step=on_step)
    # What would be refused later, such as no common span, is refused before anything is written.
    warnings = in_step(rig, synchrony.starts).warnings if synchrony.starts else rig.warnings
    with staged_files(folder) as staging:
        write_rig_folder(rig, staging, synchrony.starts)
        (staging / NAME).write_text(sync_document(synchrony), encoding="utf-8")
    for warning in (*warnings, *synchrony.warnings, *_left_behind(rig)):
        warn_as(parser)(warning)
    print_text("\n".join(_table(synchrony)))


def _left_behind(rig: Rig) -> Iterator[str]:
    if rig.ignore_masks:
        yield f"{rig.path}: the masks that its calibration names are not taken over; give them with --ignore"


def _table(synchrony: Synchrony) -> Iterator[str]:
    """A row per camera: when it starts, how sure that is, and by what it is known."""
    yield "camera                start      confidence  by"
    for each in synchrony.cameras:
        if each.offset is None:
            yield f"{each.name:<20}  cannot say"
        else:
            yield f"{each.name:<20}  {each.offset:6.2f}     {each.confidence:9.0%}  {each.method}"
    if not synchrony.starts:
        yield "nothing says when these cameras start: record a clap or a flash that all of them get"
