"""The calibration's command: decogs-calibrate. Only arguments, terminal output and exit codes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from decogs.formats.cli.command_line import Parser, number_of_threads, print_text, progress, run, warn_as, whole_number
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import staged_files
from decogs.formats.files.unicode_forms import composed

if TYPE_CHECKING:
    from decogs.formats.cameras import Camera

    from .boards import Board

EDGES = ("auto", "top", "bottom", "left", "right")


def calibrate_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-calibrate``: a folder of videos to a rig."""
    parser = calibrate_parser()
    return run(parser, lambda: _calibrate(parser, parser.parse_args(arguments)), cleans_up=True, extra="encode")


def calibrate_parser() -> Parser:
    """The options of ``decogs-calibrate``."""
    parser = Parser(
        prog="decogs-calibrate",
        description="Find lenses and places of fixed cameras from their videos, and write a rig that encodes read.",
        epilog="Without a board needs pip install 'decogs[calibrate]'. Same videos and seed, same bytes, on any "
        "number of threads.",
    )
    parser.add_argument("videos_dir", help="the folder with one video for each camera")
    parser.add_argument("-o", "--output", required=True, metavar="RIG_DIR", help="for rig.json and calibration.json")
    parser.add_argument(
        "--board",
        metavar="B",
        help="charuco:COLSxROWS:SQUARE:MARKER[:DICT] or chessboard:COLSxROWS:SQUARE, squares counted, lengths in "
        "metres: a board that moves through the take; a ChArUco also printed inverted or seen from its back through "
        "glass (default: none, structure from motion)",
    )
    lenses = parser.add_mutually_exclusive_group()
    lenses.add_argument(
        "--intrinsics",
        metavar="FILE",
        help="lenses, which stay: a calibration.json or any rig, by the cameras' names, or with one lens for all",
    )
    lenses.add_argument(
        "--lenses-only",
        action="store_true",
        help="write calibration.json with lenses alone, from a board in pictures that need not be of one instant",
    )
    parser.add_argument(
        "--distance",
        type=composed,
        metavar="CAM_A:CAM_B:METRES",
        help="between two cameras: the unit becomes the metre (without a board)",
    )
    parser.add_argument(
        "--up",
        choices=EDGES,
        default="auto",
        help="the edge that points up in most pictures (default: as most are held)",
    )
    parser.add_argument(
        "--sync",
        metavar="S",
        help="auto: bring videos in step by timecode or sound, before they are looked at; or a sync.json (default: "
        "frame k of all is one instant)",
    )
    parser.add_argument(
        "--frames", type=whole_number, metavar="N", help="instants looked at (default: 120 with a board, else 8)"
    )
    parser.add_argument("--seed", type=whole_number, default=0, metavar="S", help="of random choices (default 0)")
    parser.add_argument(
        "--shared-intrinsics", action="store_true", help="one lens for all cameras of one size (without a board)"
    )
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_quiet()
    return parser


def _calibrate(parser: Parser, options: argparse.Namespace) -> None:
    from .boards import parse_board
    from .calibrate import calibrate
    from .page import page_of
    from .placed import by_reason, parse_distance
    from .written import check_folder, write_rig

    if options.frames is not None and options.frames < 1:
        raise UsageError("`frames`: needs at least 1")
    board = None if options.board is None else parse_board(options.board)
    check_folder(Path(options.output), options.intrinsics, lenses_only=options.lenses_only)
    if options.lenses_only:
        _find_lenses(parser, options, board)
        return
    with staged_files(Path(options.output)) as staging:
        with progress("calibrating", "step", quiet=options.quiet) as on_step:
            calibration = calibrate(
                Path(options.videos_dir),
                board=board,
                frames=options.frames,
                seed=options.seed,
                shared_intrinsics=options.shared_intrinsics,
                intrinsics=None if options.intrinsics is None else Path(options.intrinsics),
                distance=None if options.distance is None else parse_distance(options.distance),
                up=options.up,
                sync=options.sync,
                threads=options.threads,
                on_step=on_step,
            )
        write_rig(calibration, Path(options.output), staging, page_of(calibration, options.output))
    for warning in calibration.warnings:
        warn_as(parser)(warning)
    for reason, names in by_reason(calibration.not_connected).items():
        warn_as(parser)(f"{names}: not connected: {reason}")
    for doubt, names in by_reason(calibration.doubts).items():
        warn_as(parser)(f"{names}: {doubt}")
    lines = [_line(one.camera, one.error) for one in calibration.placed]
    print_text("\n".join([*lines, f"{len(calibration.placed)} cameras placed ({calibration.way})"]))


def _find_lenses(parser: Parser, options: argparse.Namespace, board: Board | None) -> None:
    from .calibrate import calibrate_lenses
    from .placed import by_reason
    from .written import write_lenses

    if board is None:
        raise UsageError("`lenses_only`: lenses are found from a board; state it with `board`")
    for name in ("distance", "sync", "shared_intrinsics"):
        if getattr(options, name):
            raise UsageError(f"`{name}`: says nothing of lenses alone; leave it away, or `lenses_only`")
    with staged_files(Path(options.output)) as staging:
        with progress("calibrating", "step", quiet=options.quiet) as on_step:
            lenses, doubts, way = calibrate_lenses(
                Path(options.videos_dir), board, options.frames, threads=options.threads, on_step=on_step
            )
        write_lenses(lenses, staging)
    for doubt, names in by_reason(doubts).items():
        warn_as(parser)(f"{names}: {doubt}")
    lines = [_line(camera, error) for camera, error in lenses.values()]
    print_text("\n".join([*lines, f"{len(lines)} lenses found ({way})"]))


def _line(camera: Camera, error: float) -> str:
    return f"{camera.name}: focal {camera.fx:.1f} px, lens {camera.distortion_model}, error {error:.2f} px"
