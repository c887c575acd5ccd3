"""The decoder's commands: decogs-decode, decogs-export, decogs-info and decogs-view.

Only arguments and what is printed; the work is done by ``decode``, ``export``, ``info`` and ``view`` of
``decogs.decoder``.
SIGTERM and SIGHUP end a command that writes files as soon as it has removed what is not whole.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from decogs.codec.header.profiles import PROFILES
from decogs.formats.cli.command_line import (
    Parser,
    colour,
    counted,
    frame_rate,
    number,
    number_of_bytes,
    number_of_threads,
    path_or_pipe,
    print_text,
    printable,
    progress,
    run,
    size_text,
    standard_input,
    warn_as,
    whole_number,
)
from decogs.formats.errors import UsageError
from decogs.formats.frames.ranges import frame_range
from decogs.formats.geometry.up_direction import UPS
from decogs.formats.usd.prims import FLAVOURS

from .limits import DEFAULT_MAX_MEMORY

if TYPE_CHECKING:
    from .rendering.layouts import Layout


def decode_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-decode``: pictures of any view of any frames."""
    parser = decode_parser()
    return run(parser, lambda: _decode(parser, parser.parse_args(arguments)), cleans_up=True)


def decode_parser() -> Parser:
    """The options of ``decogs-decode``."""
    parser = Parser(
        prog="decogs-decode",
        description="Decode a view of a .dgs stream to pictures, one per encoded frame.",
        epilog="OUTPUT chooses the kind: a folder (PNG files), or a name ending in .png, .exr, .mp4, .mov, .y4m, .rgb, "
        "or .wav for the sound alone; x_####.exr, x_%04d.exr and x_$F4.exr number files by frame; - writes Y4M to "
        "stdout. docs/cameras.md describes pose files.",
    )
    parser.add_argument("stream", help="the .dgs file; - for stdin")
    parser.add_argument("-o", "--output", required=True, metavar="OUTPUT", help="folder or file to write, - for stdout")
    parser.add_quiet()
    _add_camera(parser.add_argument_group("camera (one of the first four is needed for pictures)"))
    pictures = parser.add_argument_group("frames and pictures")
    _add_pictures(pictures)
    _add_layer(pictures)
    _add_video(parser.add_argument_group("video"))
    _add_trust(parser.add_argument_group("machine and damage"), threads=True)
    return parser


def _add_camera(group: argparse._ArgumentGroup) -> None:
    view = group.add_mutually_exclusive_group()
    view.add_argument("--view", metavar="CAM", help="a camera of the rig, by name (decogs-info lists them)")
    view.add_argument(
        "--camera", metavar="FILE", help="a free camera or a path of them: pose.json, nerfstudio, USD (docs/cameras.md)"
    )
    view.add_argument(
        "--orbit", dest="move", action="store_const", const="orbit", help="a camera move: an arc around the scene"
    )
    view.add_argument(
        "--spiral",
        dest="move",
        action="store_const",
        const="spiral",
        help="a camera move: small circles before the scene",
    )
    layout = group.add_mutually_exclusive_group()
    layout.add_argument(
        "--stereo", type=number, metavar="BASELINE", help="stereo pairs side by side; BASELINE in world units"
    )
    layout.add_argument("--equirectangular", action="store_true", help="360 degrees around the camera's position")
    group.add_argument("--undistorted", action="store_true", help="leave out the rig camera's lens distortion")
    group.add_argument(
        "--drift-free",
        action="store_true",
        help="rig cameras without their drift: the scene's own colours, the calibrated pose",
    )


def _add_pictures(group: argparse._ArgumentGroup) -> None:
    _add_frames(group)
    group.add_argument("--scale", type=number, default=1.0, metavar="S", help="scale of the picture size (default 1)")
    group.add_argument(
        "--background",
        type=colour,
        metavar="R,G,B",
        help="background colour, 0 to 1 each, or black, grey, white (default: the stream's; of a subject without a "
        "background, PNG, EXR and ProRes then have alpha)",
    )
    _add_subject(group)
    group.add_argument(
        "--unseen",
        choices=("drawn", "transparent"),
        default="drawn",
        help="what no camera of the rig saw: drawn as the Gaussians have it (default), or left out, with alpha in PNG, "
        "EXR and ProRes",
    )
    group.add_argument(
        "--follow", action="store_true", help="decode frames while an encoder writes them; give the stream's final name"
    )
    group.add_argument(
        "--idle",
        type=number,
        metavar="S",
        help="with --follow: stop after S seconds without data (default 600)",
    )


def _add_subject(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--subject",
        metavar="DIR",
        help="of a whole scene only the subject, by its mattes: DIR/cam00/0000.png or DIR/cam00.mp4 (docs/masks.md)",
    )


def _add_video(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--codec", choices=("h264", "hevc", "prores"), help="video codec (default: h264 for .mp4, prores for .mov)"
    )
    group.add_argument("--crf", type=number, metavar="Q", help="quality of H.264 and HEVC, 0 (best) to 51 (default 2)")
    group.add_argument(
        "--chroma",
        choices=("420", "444"),
        help="chroma of H.264 and HEVC: 420 plays in all browsers (default), 444 is closer to the PNGs",
    )
    sound = group.add_mutually_exclusive_group()
    sound.add_argument(
        "--audio", metavar="FILE", help="sound for the video, from frame 0 on, instead of the stream's own"
    )
    sound.add_argument("--silent", action="store_true", help="leave out the stream's sound")


def export_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-export``: frames of a stream as a USD file, or as files of Gaussians."""
    parser = export_parser()
    return run(parser, lambda: _export(parser, parser.parse_args(arguments)), cleans_up=True)


def export_parser() -> Parser:
    """The options of ``decogs-export``."""
    parser = Parser(
        prog="decogs-export",
        description="Export a .dgs stream as USD for Blender, Houdini, usdview, or as splats for viewers.",
        epilog="OUTPUT's ending chooses: .usdc, .usda, .usd and .usdz hold all frames; .ply, .spz, .sog, .splat "
        "and .glb one, numbered by x_####.ply, x_%04d.ply, 'x_$F4.ply'. docs/exports.md says what suits which "
        "program.",
    )
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument("-o", "--output", required=True, metavar="OUTPUT", help="the file or files; - for stdout")
    parser.add_quiet()
    world = parser.add_argument_group("frames and world")
    _add_world(world)
    _add_layer(world)
    _add_kind(parser.add_argument_group("kind of file"))
    _add_trust(parser.add_argument_group("machine and damage"))
    return parser


def _add_world(group: argparse._ArgumentGroup) -> None:
    _add_frames(group)
    _add_subject(group)
    group.add_argument(
        "--first-frame", type=whole_number, default=0, metavar="N", help="number that frame 0 gets (default 0)"
    )
    group.add_argument("--fps", type=frame_rate, metavar="F", help="frames per second (default: the stream's)")
    group.add_argument(
        "--up",
        choices=UPS,
        default="auto",
        help="the world's up direction, rotated to the format's; auto: from the cameras (default)",
    )
    group.add_argument(
        "--scale-to-metres", type=number, metavar="F", help="metres of a world unit (default: the rig's, else 1)"
    )


def _add_kind(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--format", metavar="KIND", help="with -o -: kind of file, such as ply")
    group.add_argument("--spz-version", type=int, choices=(2, 3, 4), help="version of .spz files (default 3)")
    group.add_argument(
        "--prim",
        choices=FLAVOURS,
        help="USD: ellipsoids, for all programs (instancer, default), ParticleField3DGaussianSplat (splat), or both",
    )
    group.add_argument(
        "--velocities", action="store_true", help="USD: write the instances' velocities, for motion blur"
    )


def info_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-info``: what a stream holds, frame by frame, and where its bytes go."""
    parser = info_parser()
    return run(parser, lambda: _info(parser.parse_args(arguments)))


def info_parser() -> Parser:
    """The options of ``decogs-info``."""
    parser = Parser(prog="decogs-info", description="Show what a .dgs stream holds; verifies every frame.")
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument("--json", action="store_true", help="print everything as JSON, the table of --bytes included")
    parser.add_argument(
        "--bytes",
        action="store_true",
        help="print bytes instead, by frame and attribute",
    )
    parser.add_argument(
        "--profile",
        choices=list(PROFILES),
        metavar="PROFILE",
        help=f"fail unless the stream, or its base, keeps within it: {', '.join(PROFILES)}",
    )
    parser.add_quiet()
    _add_trust(parser)
    return parser


def view_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-view``: a stream played in the browser, or a folder for a web server that does so."""
    parser = view_parser()
    return run(parser, lambda: _view(parser.parse_args(arguments)), cleans_up=True)


def view_parser() -> Parser:
    """The options of ``decogs-view``."""
    parser = Parser(
        prog="decogs-view",
        description="Play a .dgs stream in the browser, from wherever one likes. Serves it to this machine only.",
        epilog="With -o nothing is served: OUTPUT is a folder that plays the stream on any static web server.",
    )
    parser.add_argument("stream", help="the .dgs file; - for stdin, such as the pipe of an encode that goes on")
    parser.add_argument("-o", "--output", metavar="OUTPUT", help="write the page and the stream into this folder")
    parser.add_argument(
        "--overwrite", action="store_true", help="with -o: into a folder that is there; its other files stay"
    )
    parser.add_argument(
        "--url",
        metavar="URL",
        help="with -o: where the folder will be on the web; links to its page then show a picture everywhere",
    )
    parser.add_argument(
        "--fence",
        metavar="FENCE.JSON",
        help="with -o: views stay where decogs-report -o FENCE.JSON found that it holds",
    )
    parser.add_argument(
        "--rig",
        metavar="RIG_DIR",
        help="the rig it was encoded from: shows what its cameras recorded beside their views",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address")
    parser.add_argument("--port", type=whole_number, default=0, metavar="N", help="default: any that is free")
    parser.add_argument(
        "--follow", action="store_true", help="play frames as an encoder writes them; name the file or its .part"
    )
    parser.add_argument(
        "--idle",
        type=number,
        metavar="S",
        help="with --follow: wait S seconds for the stream's beginning (default 600)",
    )
    parser.add_quiet()
    return parser


def _decode(parser: Parser, options: argparse.Namespace) -> None:
    from .decoding import decode
    from .output.video import VideoSettings
    from .reading.following import DEFAULT_IDLE

    if options.output.lower().endswith(".wav"):
        _decode_sound(parser, options)
        return
    started = time.perf_counter()
    output = path_or_pipe(options.output, "the video")
    audio = None if options.audio is None else Path(options.audio)
    with progress("decoding", quiet=options.quiet) as on_frame:
        report = decode(
            standard_input() if options.stream == "-" else options.stream,
            output,
            layout=_layout(options),
            video=VideoSettings(options.codec, options.crf, options.chroma, audio, options.silent),
            view=options.view,
            camera=options.camera,
            move=options.move,
            frames=frame_range(options.frames),
            scale=options.scale,
            background=options.background,
            subject=options.subject,
            undistorted=options.undistorted,
            drift_free=options.drift_free,
            unseen=options.unseen,
            threads=options.threads,
            strict=options.strict,
            max_memory=options.max_memory,
            layer=options.layer,
            follow=options.follow,
            idle=DEFAULT_IDLE if options.idle is None else options.idle,
            on_frame=on_frame,
            on_warning=warn_as(parser),
        )
    print_text(
        f"{printable(options.output)}: {counted(report.frame_count, 'frame')} of {report.view}, "
        f"{report.width}x{report.height}, in {time.perf_counter() - started:.1f} s",
        to_stderr=options.output == "-",
    )


def _decode_sound(parser: Parser, options: argparse.Namespace) -> None:
    from .exporting.sound import decode_sound

    wanted = {"view": options.view, "camera": options.camera, "audio": options.audio, "follow": options.follow or None}
    for name, value in {**wanted, "move": options.move}.items():
        if value is not None:
            raise UsageError(f"{options.output}: is the stream's sound, for which there is no `{name}`; leave it out")
    with progress("decoding", quiet=options.quiet) as on_frame:
        report = decode_sound(
            whole_file(options.stream),
            options.output,
            frames=frame_range(options.frames),
            strict=options.strict,
            max_memory=options.max_memory,
            on_frame=on_frame,
            on_warning=warn_as(parser),
        )
    frames, tracks = counted(report.frame_count, "frame"), counted(report.track_count, "track")
    print_text(f"{printable(options.output)}: {tracks} of {frames}, {report.seconds:.2f} s")


def _layout(options: argparse.Namespace) -> Layout | None:
    from .rendering.layouts import Equirectangular, Stereo

    if options.equirectangular:
        return Equirectangular()
    return None if options.stereo is None else Stereo(options.stereo)


def _export(parser: Parser, options: argparse.Namespace) -> None:
    from .exporting.exporting import export

    output = path_or_pipe(options.output, "the file")
    with progress("exporting", quiet=options.quiet) as on_frame:
        report = export(
            whole_file(options.stream),
            output,
            frames=frame_range(options.frames),
            up=options.up,
            first_frame=options.first_frame,
            fps=options.fps,
            scale_to_metres=options.scale_to_metres,
            format=options.format,
            spz_version=options.spz_version,
            velocities=options.velocities,
            prim=options.prim,
            subject=options.subject,
            strict=options.strict,
            max_memory=options.max_memory,
            layer=options.layer,
            on_frame=on_frame,
            on_warning=warn_as(parser),
        )
    parts = [counted(report.frame_count, "frame")]
    if report.static_count is not None:
        parts.append(f"{report.static_count} static and {report.dynamic_count} dynamic Gaussians")
    if report.file_count > 1:
        parts.append(counted(report.file_count, "file"))
    up = "nothing turned" if report.up is None else f"the world's up, {report.up}, is {report.up_in_file} there"
    parts += [size_text(report.file_bytes), up]
    if report.metres != 1:
        parts.append(f"a unit is {report.metres:g} m")
    if report.static_count is not None:
        parts.append("Blender shows its colours with the add-on (docs/blender.md)")
    print_text(f"{printable(options.output)}: {', '.join(parts)}", to_stderr=options.output == "-")


def _info(options: argparse.Namespace) -> None:
    from .reading.info import info
    from .reading.info_text import byte_lines, summary_lines

    with progress("reading", quiet=options.quiet) as on_frame:
        facts = info(
            whole_file(options.stream), strict=options.strict, max_memory=options.max_memory, on_frame=on_frame
        )
    if options.profile is not None:
        facts.check(PROFILES[options.profile])
    if options.json:
        print_text(json.dumps(facts.to_json(), indent=2))
    else:
        print_text("\n".join(byte_lines(facts) if options.bytes else summary_lines(facts)))


def whole_file(stream: str) -> str:
    """A stream that is read more than once, or from its end on; raises UsageError for a pipe."""
    if stream == "-" and not os.path.exists(stream):
        raise UsageError(
            "-: a pipe cannot be seeked; write the stream to a file first, or decode it with decogs-decode -"
        )
    return stream


def _view(options: argparse.Namespace) -> None:
    if options.output is not None:
        _write_site(options)
        return
    if options.url is not None:
        raise UsageError("`url` is where a folder will be; write one with `output`")
    if options.fence is not None:
        raise UsageError("`fence` goes into a folder; write one with `output`, or open the page with ?fence=ADDRESS")
    from .reading.following import DEFAULT_IDLE
    from .viewing.notebook import view

    idle = DEFAULT_IDLE if options.idle is None else options.idle
    browser = False if options.no_browser else None
    stream = standard_input() if options.stream == "-" else options.stream
    # From the moment the address is out, Ctrl-C is how it ends.
    with (
        view(stream, port=options.port, follow=options.follow, idle=idle, browser=browser, rig=options.rig) as served,
        suppress(KeyboardInterrupt),
    ):
        print_text(f"{printable(options.stream)}: {served.url} (Ctrl-C ends it)")
        served.wait()


def _write_site(options: argparse.Namespace) -> None:
    from .viewing.site import write_site

    if options.rig is not None:
        raise UsageError("a folder gets no pictures of a `rig`, which are large and yours; leave out `rig`")
    if options.follow:
        raise UsageError("a folder holds a whole stream; leave out `follow`, or wait for the encoder")
    with progress("writing", "MB", quiet=options.quiet) as on_megabytes:
        report = write_site(
            whole_file(options.stream),
            options.output,
            overwrite=options.overwrite,
            url=options.url,
            fence=options.fence,
            on_megabytes=on_megabytes,
        )
    print_text(f"{printable(options.output)}: {counted(report.file_count, 'file')}, {size_text(report.file_bytes)}")
    print_text(f"to look at it here: python3 -m http.server -d {shlex.quote(printable(options.output))}")


def _add_frames(parser: argparse._ActionsContainer) -> None:
    parser.add_argument("--frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3: (default: all)")


def _add_layer(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--layer", metavar="L", help="of a stream in layers: base, or the number of the last one (default: all)"
    )


def _add_trust(parser: argparse._ActionsContainer, *, threads: bool = False) -> None:
    if threads:
        parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_argument(
        "--strict", action="store_true", help="damage is an error; otherwise damaged frames show the last good one"
    )
    parser.add_argument(
        "--max-memory",
        type=number_of_bytes,
        default=DEFAULT_MAX_MEMORY,
        metavar="SIZE",
        help="limit of memory for stream and pictures, such as 512M or 2G (default 4G)",
    )
