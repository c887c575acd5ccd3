"""The calibration's command: decogs-calibrate. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.command_line import Parser, print_text, progress, run, warn_as, whole_number
from decogs.formats.errors import UsageError


def calibrate_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-calibrate``: a folder of videos to a rig."""
    parser = calibrate_parser()
    return run(parser, lambda: _calibrate(parser, parser.parse_args(arguments)), cleans_up=True)


def calibrate_parser() -> Parser:
    """The options of ``decogs-calibrate``."""
    parser = Parser(
        prog="decogs-calibrate",
        description="Find lenses and places of fixed cameras from their videos, and write a rig that encodes read.",
        epilog="Without a board needs pip install 'decogs[calibrate]'. Same videos and seed, same bytes.",
    )
    parser.add_argument("videos_dir", help="the folder with one video for each camera")
    parser.add_argument("-o", "--output", required=True, metavar="RIG_DIR", help="for rig.json and calibration.json")
    parser.add_argument(
        "--board",
        metavar="B",
        help="charuco:COLSxROWS:SQUARE:MARKER[:DICT], lengths in metres: a board that moves through the take, also "
        "printed inverted or seen from its back through glass (default: none, structure from motion)",
    )
    parser.add_argument(
        "--frames", type=whole_number, metavar="N", help="instants looked at (default: 120 with a board, else 8)"
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="S", help="of random choices (default 0)")
    parser.add_argument(
        "--shared-intrinsics", action="store_true", help="one lens for all cameras of one size (without a board)"
    )
    parser.add_quiet()
    return parser


def _calibrate(parser: Parser, options: argparse.Namespace) -> None:
    from .boards import parse_board
    from .calibrate import calibrate, write_rig

    if options.frames is not None and options.frames < 1:
        raise UsageError("`frames`: needs at least 1")
    board = None if options.board is None else parse_board(options.board)
    with progress("calibrating", "step", quiet=options.quiet) as on_step:
        found = calibrate(
            Path(options.videos_dir),
            board=board,
            frames=options.frames,
            seed=options.seed,
            shared_intrinsics=options.shared_intrinsics,
            on_step=on_step,
        )
    write_rig(found, Path(options.output))
    for name, help_ in found.not_connected.items():
        warn_as(parser)(f"{name}: not connected: {help_}")
    for name, doubt in found.doubts.items():
        warn_as(parser)(f"{name}: {doubt}")
    lines = [
        f"{one.camera.name}: focal {one.camera.fx:.1f} px, lens {one.camera.distortion_model}, error {one.error:.2f} px"
        for one in found.placed
    ]
    print_text("\n".join([*lines, f"{len(found.placed)} cameras placed ({found.way})"]))
