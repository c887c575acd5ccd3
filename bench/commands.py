"""The bench's command: decogs-bench. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.cli.command_line import Parser, number, number_of_threads, run, warn_as, whole_number
from decogs.formats.files.unicode_forms import composed
from decogs.formats.frames.ranges import frame_range


def bench_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-bench``: rigs to a report of what the encoder does on them."""
    parser = bench_parser()
    given = list(sys.argv[1:] if arguments is None else arguments)
    return run(parser, lambda: _bench(parser, parser.parse_args(given), given), extra="bench")


def bench_parser() -> Parser:
    """The options of ``decogs-bench``."""
    parser = Parser(
        prog="decogs-bench",
        description="Encode rigs in many ways, measure each on a held-out camera, and write a report.",
        epilog="Results are kept in OUTPUT/runs: an interrupted report goes on where it stopped.",
    )
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="KIND")
    for name, seeds, about in (
        ("paper", 1, "the paper's tables and figures: methods, components, frame rates, tau and r"),
        ("choices", 3, "what the paper leaves open and every default, one table per question"),
        ("rates", 1, "rate and distortion: several rates, and other ways to keep the same frames"),
        ("effects", 3, "detected effects, all, none, and each one wrongly disabled"),
        ("curve", 3, "what accuracy costs in time: presets and single settings, and the Pareto front"),
    ):
        # No abbreviations: --seed 7, one seed elsewhere, would be seven of them here.
        kind = kinds.add_parser(name, help=about, allow_abbrev=False)
        _add_options(kind, frames="all")
        _add_options_of_variants(kind, seeds)
    views = kinds.add_parser(
        "views",
        help="viewpoints where no camera stood: every camera left out in turn",
        epilog="PSNR of what it sees, of subject and rest apart where the rig has truth/mattes; haze (alpha before the "
        "first surface) and the floaters that make it.",
    )
    _add_options(views, frames="the first alone")
    views.add_argument("--seed", type=whole_number, default=0, metavar="N", help="of all runs (default 0)")
    views.add_argument(
        "--cameras", default="all", metavar="C", help="all, a number of them, evenly spread, or names with commas"
    )
    return parser


def _add_options(parser: Parser, *, frames: str) -> None:
    parser.add_argument("rigs", nargs="+", metavar="RIG", help="the rigs' folders")
    parser.add_argument("-o", "--output", required=True, metavar="OUTPUT", help="folder of the report")
    parser.add_argument("--frames", metavar="A:B", help=f"half-open, as in Python: 0:10, 5:, -3: (default: {frames})")
    parser.add_argument("--scale", type=number, default=1.0, metavar="S", help="size of the pictures")
    parser.add_argument(
        "--preset", dest="settings", default="standard", metavar="P", help="what encodes start from (default standard)"
    )
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_argument("--any-code", action="store_true", help="take results that other code made")
    parser.add_quiet()


def _add_options_of_variants(parser: argparse.ArgumentParser, seeds: int) -> None:
    parser.add_argument(
        "--seeds",
        type=_seeds,
        default=range(seeds),
        metavar="N",
        help=f"so many seeds from 0 on, or a list (0,3,7): means, standard errors, differences (default {seeds})",
    )
    parser.add_argument(
        "--holdout",
        action="append",
        type=composed,
        metavar="CAM",
        help="camera to measure on (repeatable: means over all; default: the rig's own, or cam00)",
    )
    parser.add_argument(
        "--only", default="", metavar="PARTS", help="run for these tables only (with commas); none: no run"
    )
    parser.add_argument("--keep-streams", action="store_true", help="leave the .dgs files in OUTPUT/streams")


def _seeds(text: str) -> Sequence[int]:
    """So many seeds from 0 on, or those in a list with commas ("7," has one)."""
    numbers = [whole_number(word) for word in text.removesuffix(",").split(",")]
    return numbers if "," in text else range(numbers[0])


def _bench(parser: Parser, options: argparse.Namespace, given: Sequence[str]) -> None:
    report = _views_report if options.kind == "views" else _report_of_variants
    print(report(parser, options, _command(given, [*options.rigs, options.output])))


def _views_report(parser: Parser, options: argparse.Namespace, command: str) -> Path:
    from .views.left_out import LeftOutOptions
    from .views.report import make_views_report

    return make_views_report(
        options.rigs,
        options.output,
        LeftOutOptions(
            cameras=_cameras(options.cameras),
            frames=frame_range(options.frames),
            scale=options.scale,
            settings=options.settings,
            threads=options.threads,
            seed=options.seed,
            any_code=options.any_code,
        ),
        command=command,
        terminal=None if options.quiet else sys.stderr,
    )


def _cameras(text: str) -> int | list[str] | None:
    if text == "all":
        return None
    return int(text) if text.isdecimal() else text.split(",")


def _report_of_variants(parser: Parser, options: argparse.Namespace, command: str) -> Path:
    from .reports.report import PLANS, make_report
    from .runs.run import BenchOptions

    return make_report(
        PLANS[options.kind],
        options.rigs,
        options.output,
        BenchOptions(
            holdout=options.holdout or (),
            frames=frame_range(options.frames),
            scale=options.scale,
            preset=options.settings,
            threads=options.threads,
            seeds=options.seeds,
            any_code=options.any_code,
            keep_streams=options.keep_streams,
        ),
        only=[part for part in options.only.split(",") if part],
        command=command,
        terminal=None if options.quiet else sys.stderr,
        on_warning=warn_as(parser),
    )


def _command(given: Sequence[str], folders: Sequence[str]) -> str:
    """The command as it was given, folders by their names only: where they lay says nothing elsewhere."""
    return shlex.join(["decogs-bench", *(Path(word).name if word in folders else word for word in given)])
