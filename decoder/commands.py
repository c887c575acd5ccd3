"""The decoder's commands: decogs-decode, decogs-export and decogs-info.

Only arguments, terminal output and exit codes; the work is done by ``decode``, ``export`` and ``info`` of
``decogs.decoder``. Exit code 0 when all went well, 2 after an error (one line on stderr), 130 after Ctrl-C. SIGTERM and
SIGHUP end a command that writes pictures or USD as soon as it has removed what is not whole.
"""

from __future__ import annotations

import argparse
import errno
import io
import json
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, BinaryIO, NoReturn

from decogs.formats.errors import DecogsError, UsageError

from .memory import DEFAULT_MAX_MEMORY

if TYPE_CHECKING:
    from decogs.codec.header import StreamHeader

    from .inspection import FrameInfo, StreamInfo

USER_ERROR = 2
INTERRUPTED = 130
_BROKEN_PIPE = 141
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f]+")

OnFrame = Callable[[int, int], None]


def decode_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-decode``: pictures of any view of any frames."""
    parser = Parser(
        prog="decogs-decode",
        description="Decode a view of a .dgs stream to pictures, one per encoded frame.",
        epilog="OUTPUT chooses the kind: a folder (PNG files), or a name ending in .png, .exr or .mp4; "
        "x_%%06d.exr numbers files by frame. A pose file is described in decogs.decoder.free_camera.",
    )
    parser.add_argument("stream", help="the .dgs file; - for stdin")
    parser.add_argument("-o", "--output", required=True, metavar="OUTPUT", help="folder, .png, .exr or .mp4 to write")
    view = parser.add_mutually_exclusive_group(required=True)
    view.add_argument("--view", metavar="CAM", help="a camera of the rig, by name (decogs-info lists them)")
    view.add_argument("--camera", metavar="POSE.JSON", help="a free camera, or a path of one camera per frame")
    _add_frames(parser)
    _add_trust(parser)
    parser.add_argument("--scale", type=number, default=1.0, metavar="S", help="size of the pictures (default 1)")
    parser.add_argument("--background", type=_colour, metavar="R,G,B", help="0 to 1 each (default: the stream's)")
    parser.add_argument("--undistorted", action="store_true", help="leave out the rig camera's lens distortion")
    parser.add_argument(
        "--canonical",
        action="store_true",
        help="the scene's own colours and the calibrated pose, not the exposure, white balance and shake recorded",
    )
    parser.add_argument("--threads", type=number_of_threads, default=0, metavar="N", help="default: all processors")
    parser.add_argument(
        "--follow", action="store_true", help="decode frames as an encoder writes them; name the file it will become"
    )
    parser.add_argument(
        "--idle",
        type=number,
        metavar="S",
        help="with --follow: stop when nothing came for S seconds (default 600)",
    )
    return run(parser.prog, lambda: _decode(parser.parse_args(frames_joined(arguments))), cleans_up=True)


def export_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-export``: frames of a stream as a USD file."""
    parser = Parser(prog="decogs-export", description="Export a .dgs stream as USD, for Blender, Houdini, usdview.")
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument("-o", "--output", required=True, metavar="OUTPUT", help="the .usdc or .usda file to write")
    _add_frames(parser)
    _add_trust(parser)
    parser.add_argument(
        "--up-axis", choices=("Y", "Z"), default="Y", help="which world axis is up; nothing is rotated (default Y)"
    )
    return run(parser.prog, lambda: _export(parser.parse_args(frames_joined(arguments))), cleans_up=True)


def info_main(arguments: Sequence[str] | None = None) -> int:
    """``decogs-info``: what a stream holds, frame by frame, and where its bytes go."""
    parser = Parser(prog="decogs-info", description="Show what a .dgs stream holds; verifies every frame.")
    parser.add_argument("stream", help="the .dgs file")
    parser.add_argument("--json", action="store_true", help="print everything as JSON, the table of --bytes included")
    parser.add_argument(
        "--bytes",
        action="store_true",
        help="print where every byte goes instead: frame by frame, attribute by attribute",
    )
    _add_trust(parser)
    return run(parser.prog, lambda: _info(parser.parse_args(frames_joined(arguments))))


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line, as for every other error."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Refuses "--" as the value of an option, which argparse takes away and then hands on an empty list."""
        parsed = super().parse_args(args, namespace)
        for name, value in vars(parsed).items():
            is_empty = value == [] and self.get_default(name) != []
            if is_empty or (isinstance(value, list) and [] in value):
                self.error(f"argument --{name.replace('_', '-')}: expected one argument")
        return parsed

    def error(self, message: str) -> NoReturn:
        sys.stderr.write(f"{self.prog}: error: {message} (see {self.prog} --help)\n")
        raise SystemExit(USER_ERROR)


def run(program: str, command: Callable[[], int | None], *, cleans_up: bool = False) -> int:
    """Runs a command and returns its exit code; an error the user can act on becomes one line on stderr.

    The command returns an exit code of its own, or None for 0. ``cleans_up``: SIGTERM and SIGHUP let it remove what it
    has written by halves before they end the process; without, they do so at once.
    """
    _open_standard_streams()
    if sys.stdout is None:
        return _say(f"{program}: error: standard output is closed; send it to a file, or to /dev/null", USER_ERROR)
    try:
        with _unwinding_signals() if cleans_up else nullcontext():
            code = command()
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of a pipe (head, less) has seen enough.
        _forget_stdout()
        return _BROKEN_PIPE
    except KeyboardInterrupt:
        return _say(f"{program}: interrupted", INTERRUPTED)
    except DecogsError as error:
        return _say(f"{program}: error: {error}", USER_ERROR)
    except OSError as error:
        where = error.filename or (None if _stdout_takes_it() else "standard output")
        what = f"{where}: {error.strerror}" if where else error.strerror or str(error)
        if error.errno == errno.ENOSPC:
            what += "; make room, or write elsewhere"
        return _say(f"{program}: error: {what}", USER_ERROR)
    except Exception as error:
        if not _memory_is_out(error):
            raise
        return _say(f"{program}: error: out of memory; choose a smaller scale or fewer frames", USER_ERROR)
    return code or 0


def _open_standard_streams() -> None:
    """Gives standard streams that are closed an end that swallows.

    The next file that is opened would otherwise get their number, and with it what libraries have to say on stderr.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # noqa: PERF203 (three turns)
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 (as long as the process)
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Names come from strangers: what this terminal's encoding cannot show is escaped.
        sys.stdout.reconfigure(errors="backslashreplace")


def _stdout_takes_it() -> bool:
    """Whether standard output takes what waits for it; a full disk does not, whoever first came upon that."""
    try:
        sys.stdout.flush()
    except OSError:
        _forget_stdout()
        return False
    return True


def _forget_stdout() -> None:
    """Keeps the interpreter from flushing once more what cannot be written."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _memory_is_out(error: Exception) -> bool:
    """Whether an exception means that memory is short, as the libraries beneath have several words for it."""
    words = {
        RuntimeError: "can't start new thread",
        ImportError: "allocate memory|failed to map segment",
    }
    said = next((words[kind] for kind in words if isinstance(error, kind)), None)
    from_opencv = type(error).__module__ == "cv2" and "Insufficient memory" in str(error)
    return isinstance(error, MemoryError) or from_opencv or (said is not None and bool(re.search(said, str(error))))


class _Ended(BaseException):
    """A signal asks the process to end."""


@contextmanager
def _unwinding_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP leave what is inside as Ctrl-C does, then end the process; a second one ends it at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def unwind(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _Ended(number)

    # What is ignored, as SIGHUP under nohup, or is handled by whoever runs this in their program, stays so.
    ours = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, unwind)
    try:
        yield
    except _Ended as ended:
        os.kill(os.getpid(), ended.args[0])
        raise
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def standard_input() -> BinaryIO:
    """The bytes of standard input; UsageError when that is closed."""
    if sys.stdin is None:
        raise UsageError("-: standard input is closed; pipe a stream into it, or name a file")
    return sys.stdin.buffer


@contextmanager
def progress(what: str, unit: str = "frame") -> Iterator[OnFrame]:
    """A progress bar on stderr when that is a terminal; silent otherwise. Called with units done and units in all."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from tqdm import tqdm

    with tqdm(desc=what, unit=unit, leave=False) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show


def tell(text: str, *, to_stderr: bool = False) -> None:
    """Prints; what keeps the standard stream from being written is said with its name."""
    try:
        print(text, file=sys.stderr if to_stderr else sys.stdout, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        error.filename = "standard error" if to_stderr else "standard output"
        raise


def _decode(options: argparse.Namespace) -> None:
    from .following import DEFAULT_IDLE
    from .output import decode

    started = time.perf_counter()
    with progress("decoding") as on_frame:
        report = decode(
            standard_input() if options.stream == "-" else options.stream,
            options.output,
            view=options.view,
            camera=options.camera,
            frames=options.frames,
            scale=options.scale,
            background=options.background,
            undistorted=options.undistorted,
            canonical=options.canonical,
            threads=options.threads,
            strict=options.strict,
            max_memory=options.max_memory,
            follow=options.follow,
            idle=DEFAULT_IDLE if options.idle is None else options.idle,
            on_frame=on_frame,
            on_warning=warn_as("decogs-decode"),
        )
    tell(
        f"{options.output}: {_count(report.frame_count, 'frame')} of {report.view}, "
        f"{report.width}x{report.height}, in {time.perf_counter() - started:.1f} s"
    )


def _export(options: argparse.Namespace) -> None:
    from .output import export

    with progress("exporting") as on_frame:
        report = export(
            options.stream,
            options.output,
            frames=options.frames,
            up_axis=options.up_axis,
            strict=options.strict,
            max_memory=options.max_memory,
            on_frame=on_frame,
            on_warning=warn_as("decogs-export"),
        )
    tell(
        f"{options.output}: {_count(report.frame_count, 'frame')}, {report.static_count} static and "
        f"{report.dynamic_count} dynamic Gaussians, {_size(report.file_bytes)}"
    )


def _info(options: argparse.Namespace) -> None:
    from .inspection import info

    with progress("reading") as on_frame:
        facts = info(options.stream, strict=options.strict, max_memory=options.max_memory, on_frame=on_frame)
    if options.json:
        tell(json.dumps(facts.to_json(), indent=2))
    else:
        tell("\n".join(_bytes(facts) if options.bytes else _table(facts)))


def _table(facts: StreamInfo) -> Iterator[str]:
    header, totals = facts.header, facts.totals
    yield f"{facts.path}: {_size(facts.file_bytes)}, bitstream {facts.version[0]}.{facts.version[1]}"
    if not facts.complete:
        tail = f", {facts.unfinished_bytes} bytes of an incomplete packet follow" if facts.unfinished_bytes else ""
        yield f"unfinished   the stream has no end packet{tail}"
    lost = f", {totals['lost_frames']} lost" if totals["lost_frames"] else ""
    yield f"frames       {totals['frames']} ({totals['key_frames']} key, {totals['delta_frames']} delta, " + (
        f"{totals['skip_frames']} skip{lost})" + ("" if header.fps is None else f" at {header.fps:g} fps")
    )
    for damage in facts.damage:
        yield f"damage       {_printable(str(damage))}"
    for camera in header.cameras:
        lens = "" if camera.distortion_model == "none" else f", {camera.distortion_model} lens"
        yield f"camera       {camera.name}  {camera.width}x{camera.height}{lens}" + _told_of(camera.name, header)
    yield f"colour       SH degree {header.sh_degree}, background {','.join(f'{c:g}' for c in header.background)}"
    for name, text in (
        ("effects", ", ".join(header.effects)),
        ("source", header.source_text),
        ("licence", header.licence),
        ("writer", header.writer),
        ("settings", _short_settings(header.settings)),
    ):
        if text:
            yield f"{name:<12} {_printable(text)}"
    yield ""
    yield " frame kind       bytes  Gaussians   touched   added removed   share"
    yield from (_row(frame) for frame in facts.frames)
    if any(frame.refers_to_first for frame in facts.frames):
        yield "key*: told as the difference from the first keyframe, against which it counts"
    yield ""
    yield f"bytes per frame           {_number(totals['bytes_per_frame'])} (the whole file over all frames)"
    yield f"  without the first key   {_number(totals['bytes_per_frame_without_first_key'])}"
    yield f"  mean delta              {_number(totals['mean_delta_bytes'])}"
    yield f"  mean keyframe           {_number(totals['mean_key_bytes'])}"
    if totals["mean_share_touched"] is not None:
        yield f"share touched, mean       {totals['mean_share_touched']:.2%}"
    for purpose, count in sorted(totals["bytes_by_purpose"].items(), key=lambda item: -item[1]):
        yield f"bytes of {purpose:<22} {count:>10}  {count / max(1, facts.file_bytes):6.1%}"


def _told_of(name: str, header: StreamHeader) -> str:
    """What the frames tell of a camera, beside its calibration."""
    if name in header.held_out:
        return ", held out" + (", its own faults unknown: shown canonical" if header.corrected.effects else "")
    return "".join(f", {effect.replace('_', ' ')}" for effect in header.corrected.of(name))


def _bytes(facts: StreamInfo) -> Iterator[str]:
    """Bytes by frame and purpose; the rows of frames and "around" add up to the last one, and that to the file."""
    table = facts.byte_table
    names = [*table.purposes, "all"]
    widths = [max(9, len(name) + 1) for name in names]

    def line(label: str, values: Sequence[float]) -> str:
        cells = [*values, sum(values)]
        return f"{label:<14}" + "".join(f"{v:>{width}.0f}" for v, width in zip(cells, widths, strict=True))

    yield f"{'bytes':<14}" + "".join(f"{name:>{width}}" for name, width in zip(names, widths, strict=True))
    for frame, row in zip(facts.frames, table.rows, strict=True):
        yield line(f"{frame.index:>6} {frame.kind}{'*' * frame.refers_to_first}", row)
    for kind, means in table.means.items():
        yield line(f"mean of {kind}", means)
    yield line("around frames", (*[0] * (len(table.purposes) - 1), table.around))
    yield line("the file", table.totals)


def _short_settings(settings: Mapping[str, Any]) -> str:
    """The settings that are single values; groups of them are for --json."""
    shown = [f"{key}={value}" for key, value in settings.items() if not isinstance(value, Mapping)]
    return ", ".join(shown) + (" (groups: see --json)" if len(shown) < len(settings) else "")


def _row(frame: FrameInfo) -> str:
    kind = frame.kind + "*" * frame.refers_to_first
    return (
        f"{frame.index:>6} {kind:<5} {frame.bytes:>10} {frame.gaussians:>10} {frame.touched:>9} "
        f"{frame.added:>7} {frame.removed:>7} {frame.share_touched:>7.2%}"
    )


def _add_frames(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3: (default: all)")


def _add_trust(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--strict", action="store_true", help="damage is an error; otherwise damaged frames show the last good one"
    )
    parser.add_argument(
        "--max-memory",
        type=number_of_bytes,
        default=DEFAULT_MAX_MEMORY,
        metavar="SIZE",
        help="what a stream may claim, such as 512M or 2G (default 4G)",
    )


def frames_joined(arguments: Sequence[str] | None) -> list[str]:
    """Joins "--frames" with its value: argparse takes "-3:" for an option of its own."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    joined: list[str] = []
    for argument in given:
        if joined and joined[-1] == "--frames":
            joined[-1] = f"--frames={argument}"
        else:
            joined.append(argument)
    return joined


def _colour(text: str) -> tuple[float, float, float]:
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no colour; write R,G,B from 0 to 1, such as 1,1,1") from None
    return red, green, blue


def number_of_bytes(text: str) -> int:
    """A size as the user writes it: digits, and K, M or G for powers of 1024."""
    match = re.fullmatch(r"([0-9]{1,12})([KMG]?)", text, re.IGNORECASE | re.ASCII)
    if match is None or not int(match[1]):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write bytes, or a number with K, M or G, such as 512M")
    return int(match[1]) << {"": 0, "K": 10, "M": 20, "G": 30}[match[2].upper()]


def number(text: str) -> float:
    """A number in ASCII digits: Python would also take those of every other script, and underscores."""
    try:
        if text.isascii() and "_" not in text:
            return float(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no number")


def whole_number(text: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at most 18 digits")
    return int(text)


def number_of_threads(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of threads; 0 means all processors")
    return int(text)


def warn_as(program: str) -> Callable[[str], None]:
    """Prints each text it is given as one line on stderr."""
    return lambda text: print(f"{program}: warning: {_printable(text)}", file=sys.stderr)


def _say(line: str, code: int) -> int:
    print(_printable(line), file=sys.stderr)
    return code


def _printable(text: str) -> str:
    """Text of strangers on one line, without what a terminal would take for commands."""
    return _CONTROL.sub(" ", text).strip()


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" + ("" if number == 1 else "s")


def _number(value: float | None) -> str:
    return f"{'-':>10}" if value is None else f"{value:>10.0f}"


def _size(count: int) -> str:
    return f"{count} bytes" if count < 10_000 else f"{count / 1e3:.1f} kB" if count < 1e7 else f"{count / 1e6:.1f} MB"
