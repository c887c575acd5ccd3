"""The command of packing: decogs-pack. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from decogs.formats.cli.command_line import (
    Parser,
    counted,
    frame_rate,
    number,
    number_of_bytes,
    path_or_pipe,
    print_text,
    printable,
    progress,
    run,
    size_text,
    warn_as,
    whole_number,
)


def pack_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-pack``: files of Gaussians to a .dgs stream."""
    parser = pack_parser()
    return run(parser, lambda: _pack(parser, parser.parse_args(arguments)), cleans_up=True, extra="encode")


def pack_parser() -> Parser:
    """The options of ``decogs-pack``."""
    from decogs.decoder.limits import DEFAULT_MAX_MEMORY
    from decogs.formats.files.unicode_forms import composed

    parser = Parser(
        prog="decogs-pack",
        description="Code a sequence of 3D Gaussians as a stream: .ply or .spz files, one per frame, or a .4dgs or "
        ".splat4d.",
    )
    parser.add_argument(
        "files",
        metavar="NAME_####.PLY",
        help="the files' names, with ####, %%04d or $F4 for the number; or one .4dgs or .splat4d",
    )
    parser.add_argument("-o", "--output", required=True, metavar="SCENE.DGS", help="the stream to write; - for stdout")
    parser.add_argument(
        "--fps",
        type=frame_rate,
        metavar="F",
        help="frames per second, at which a .4dgs is sampled (default: the file's own; of .ply and .spz: not stated)",
    )
    parser.add_argument(
        "--rig",
        metavar="RIG_DIR",
        help="give the stream this rig's cameras, so that decogs-report can compare it with their pictures (default: "
        "one camera, overview)",
    )
    parser.add_argument(
        "--holdout",
        action="append",
        default=[],
        type=composed,
        metavar="CAM",
        help="with --rig, a camera that the files' training did not see (repeatable)",
    )
    exactness = parser.add_mutually_exclusive_group()
    exactness.add_argument(
        "--quality",
        type=number,
        default=50.0,
        metavar="Q",
        help="0 (smallest) to 100 (most exact), default 50; every 25 points lower double the lattice's steps",
    )
    exactness.add_argument(
        "--lossless", action="store_true", help="code every change, exact to the lattice of --quality 100"
    )
    parser.add_argument("--segment", type=whole_number, default=0, metavar="N", help="insert a keyframe every N frames")
    parser.add_argument(
        "--max-memory",
        type=number_of_bytes,
        default=DEFAULT_MAX_MEMORY,
        metavar="SIZE",
        help="limit of memory for a frame's Gaussians, such as 512M or 6G (default 4G)",
    )
    parser.add_quiet()
    return parser


def _pack(parser: Parser, options: argparse.Namespace) -> int:
    from decogs.formats.rigs import open_rig

    from .packing import pack

    rig = None if options.rig is None else open_rig(options.rig)
    output = path_or_pipe(options.output, "the stream")
    with progress("packing", quiet=options.quiet) as on_frame:
        report = pack(
            options.files,
            output,
            fps=options.fps,
            rig=rig,
            holdout=options.holdout,
            quality=options.quality,
            lossless=options.lossless,
            segment=options.segment,
            max_memory=options.max_memory,
            on_frame=on_frame,
            on_warning=warn_as(parser),
        )
    frames, size = counted(len(report.frame_bytes), "frame"), size_text(report.total_bytes)
    print_text(
        f"{printable(options.output)}: {frames}, {size}; what was packed has {size_text(report.read_bytes)}",
        to_stderr=options.output == "-",
    )
    return 0
