"""What the commands of all layers share: arguments, terminal output and exit codes.

Exit code 0 when all went well, 1 where ``decogs-verify`` finds a difference, 2 after an error (one line on stderr), 75
for a command that a farm runs when it may be tried again, 130 after Ctrl-C, 141 when the reader of a pipe is gone.
"""

from __future__ import annotations

import argparse
import errno
import io
import math
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any, BinaryIO, NoReturn

from ..errors import DecogsError, TryAgainError, UsageError
from ..frames.rates import read_rate
from ..system.callbacks import OnProgress
from ..system.extras import what_to_install
from ..system.operating_systems import ENDING_SIGNALS
from .progress import open_progress

USER_ERROR = 2
TRY_AGAIN = 75
INTERRUPTED = 130
_BROKEN_PIPE = 141
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f]+")
_DIRECTIONS = re.compile("[\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]")
"""Characters that end a line, or change in which order the others are shown, so that a name looks like another one."""
_PARAMETER = re.compile("`([a-z_]+)`")
"""How a library's texts name a parameter: it knows no options."""
_TAKE_DASHES = ("--frames", "--only", "--up")
_DASHED = re.compile("-[0-9].*|-[A-Z]")
"""Values that begin with a dash: frames from the end, directions."""


class Parser(argparse.ArgumentParser):
    """Knows --version, and says what is wrong with the arguments in one line, as for every other error."""

    def __init__(self, **words: Any) -> None:
        super().__init__(**words)
        self.add_argument("--version", action=_Version, help="print the version and exit")

    def add_quiet(self) -> None:
        """Adds --quiet, for commands that show progress."""
        self.add_argument("-q", "--quiet", action="store_true", help="no progress on stderr; warnings and errors stay")

    def in_options(self, text: str) -> str:
        """A library's text with each parameter in backticks as the option that sets it: ```scale``` is --scale.

        An option that sets a parameter of another name has that as its ``dest``.
        """
        options = _options_by_parameter(self)
        return _PARAMETER.sub(lambda match: options.get(match[1], match[0]), text)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Takes what argparse would not: values with a dash, such as ``--frames -3:``. Refuses what it should not.

        That is "--" as the value of an option, which argparse takes away and then hands on an empty list.
        """
        parsed = super().parse_args(_dashed_joined(sys.argv[1:] if args is None else args), namespace)
        for name, value in vars(parsed).items():
            is_empty = value == [] and self.get_default(name) != []
            if is_empty or (isinstance(value, list) and [] in value):
                self.error(f"argument {_options_by_parameter(self).get(name, name)}: expected one argument")
        return parsed

    def error(self, message: str) -> NoReturn:
        """Prints one line and ends the process with exit code 2."""
        _say(f"{self.prog}: error: {message} (see {self.prog} --help)", USER_ERROR)
        raise SystemExit(USER_ERROR)


class _Version(argparse._VersionAction):
    """Prints the version; it is only looked up when asked for, which takes a while."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from decogs import __version__

        print_text(f"{parser.prog} {__version__}")
        parser.exit()


def _dashed_joined(arguments: Sequence[str]) -> list[str]:
    """Joins an option with its value where argparse would take the value for an option of its own."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in _TAKE_DASHES and _DASHED.fullmatch(argument) and "--" not in joined:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _options_by_parameter(parser: argparse.ArgumentParser) -> dict[str, str]:
    """The first spelling of every option, by the parameter it sets; those of the commands within count as well."""
    options: dict[str, str] = {}
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for within in action.choices.values():
                options |= _options_by_parameter(within)
        elif action.option_strings:
            options[action.dest] = action.option_strings[0]
    return options


@contextmanager
def in_option_names(option_names: Mapping[str, str]) -> Iterator[None]:
    """Errors from inside name the user's options, where their values were converted for the library."""
    try:
        yield
    except DecogsError as error:
        text = str(error)
        for parameter, option in option_names.items():
            text = text.replace(parameter, option)
        error.args = (text,)
        raise


def run(parser: Parser, command: Callable[[], int | None], *, cleans_up: bool = False, extra: str | None = None) -> int:
    """Runs a command and returns its exit code; an error the user can act on becomes one line on stderr.

    ``parser``: the command's, whose options an error then names. The command returns an exit code of its own, or None
    for 0. ``cleans_up``: SIGTERM and SIGHUP let it remove what it
    has written by halves before they end the process; without, they do so at once. ``extra``: of the installation, the
    one that has all that the command needs beyond the base.
    """
    program = parser.prog
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
        return _say(f"{program}: error: {parser.in_options(str(error))}", USER_ERROR)
    except OSError as error:
        where = error.filename or (None if _stdout_takes_it() else "standard output")
        what = f"{where}: {error.strerror}" if where else error.strerror or str(error)
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            what += "; make room, or write elsewhere"
        return _say(f"{program}: error: {what}", USER_ERROR)
    except ModuleNotFoundError as error:
        what_to_do = what_to_install(error, whole=extra)
        if what_to_do is None:
            raise
        return _say(f"{program}: error: {what_to_do}", USER_ERROR)
    except Exception as error:
        if not _memory_is_out(error):
            raise
        return _say(f"{program}: error: out of memory; choose a smaller scale or fewer frames", USER_ERROR)
    return code or 0


def retryable(parser: Parser, command: Callable[[], int]) -> int:
    """Runs a command that a farm may run again: exit code 75 (sysexits.h, EX_TEMPFAIL) for what may go away by itself.

    That is a disk that is full or fails, a lack of memory, a file that another process is writing, Ctrl-C, and SIGTERM
    or SIGHUP, with which a farm takes a machine back.
    """
    try:
        with _raised_signals():
            return command()
    except BrokenPipeError:
        raise
    except TryAgainError as error:
        problem = parser.in_options(str(error))
    except OSError as error:
        problem = f"{error.filename}: {error.strerror}" if error.filename else str(error)
    except KeyboardInterrupt:
        problem = "interrupted"
    except _Ended as ended:
        problem = f"ended by {signal.Signals(ended.number).name}"
    except Exception as error:
        if not _memory_is_out(error):
            raise
        problem = "out of memory"
    return _say(f"{parser.prog}: {problem}; nothing was written, try again", TRY_AGAIN)


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
    cause = next((words[kind] for kind in words if isinstance(error, kind)), None)
    from_opencv = type(error).__module__ == "cv2" and "Insufficient memory" in str(error)
    return isinstance(error, MemoryError) or from_opencv or (cause is not None and bool(re.search(cause, str(error))))


class _Ended(BaseException):
    """A signal asks the process to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def _unwinding_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP leave what is inside as Ctrl-C does, then end the process; a second one ends it at once."""
    try:
        with _raised_signals():
            yield
    except _Ended as ended:
        os.kill(os.getpid(), ended.number)
        raise


@contextmanager
def _raised_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP leave what is inside as `_Ended`; a second one ends the process at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def unwind(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _Ended(number)

    # What is ignored, as SIGHUP under nohup, or is handled by whoever runs this in their program, stays so.
    ours = [n for n in ENDING_SIGNALS if signal.getsignal(n) is signal.SIG_DFL]
    for number in ours:
        signal.signal(number, unwind)
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)


def standard_input() -> BinaryIO:
    """The bytes of standard input; UsageError when that is closed."""
    if sys.stdin is None:
        raise UsageError("-: standard input is closed; pipe a stream into it, or name a file")
    return sys.stdin.buffer


def path_or_pipe(output: str, what: str) -> str | BinaryIO:
    """Where a command writes: the path as given, or for ``-`` the bytes of standard output.

    Raises UsageError for a terminal, which ``what`` must not go to, and where standard output is closed.
    """
    if output != "-":
        return output
    if sys.stdout is None:
        raise UsageError("-o -: standard output is closed; pipe it into a program, or name a file")
    if sys.stdout.isatty():
        raise UsageError(f"-o -: {what} would go to the terminal; redirect it, or name a file")
    return sys.stdout.buffer


@contextmanager
def progress(what: str, unit: str = "frame", *, quiet: bool = False) -> Iterator[OnProgress]:
    """Progress on stderr, called with units done and units in all; silent if ``quiet``."""
    shown = open_progress(None if quiet else sys.stderr, what, unit)
    try:
        yield shown.to
    finally:
        shown.close()


def print_text(text: str, *, to_stderr: bool = False) -> None:
    """Prints lines as `printable` has them; what keeps the standard stream from being written is said with its name."""
    try:
        print("\n".join(map(_escaped, text.split("\n"))), file=sys.stderr if to_stderr else sys.stdout, flush=True)
    except BrokenPipeError:
        raise
    except OSError as error:
        error.filename = "standard error" if to_stderr else "standard output"
        raise


def warn_as(parser: Parser) -> Callable[[str], None]:
    """Prints each text it is given as one line on stderr, with the command's options for a library's parameters."""
    return lambda text: print(f"{parser.prog}: warning: {printable(parser.in_options(text))}", file=sys.stderr)


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


def frame_rate(text: str) -> float:
    """An option's frames per second, also as a fraction; ArgumentTypeError for anything else."""
    rate = read_rate(text)
    if rate is None:
        raise argparse.ArgumentTypeError(f"{text!r} is no rate; write frames per second: 25, 29.97, 30000/1001")
    return rate


def vector(text: str) -> tuple[float, float, float]:
    """An option's three finite numbers with commas between; ArgumentTypeError for anything else."""
    parts = text.split(",")
    if len(parts) != 3 or not all(math.isfinite(number(part)) for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is no vector; write X,Y,Z, such as 0,1.5,-2")
    x, y, z = map(number, parts)
    return x, y, z


def whole_number(text: str) -> int:
    """An option's whole number in ASCII digits; ArgumentTypeError for anything else."""
    if not re.fullmatch(r"[+-]?[0-9]{1,18}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number of at most 18 digits")
    return int(text)


def number_of_threads(text: str) -> int:
    """An option's number of threads, 0 for all processors; ArgumentTypeError for anything else."""
    if not re.fullmatch(r"[0-9]{1,9}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of threads; 0 means all processors")
    return int(text)


_COLOURS = {"black": (0.0, 0.0, 0.0), "grey": (0.5, 0.5, 0.5), "white": (1.0, 1.0, 1.0)}


def colour(text: str) -> tuple[float, float, float]:
    """An option's display-referred colour: red, green and blue, or a name; ArgumentTypeError for anything else."""
    if text in _COLOURS:
        return _COLOURS[text]
    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        names = ", ".join(_COLOURS)
        raise argparse.ArgumentTypeError(
            f"{text!r} is no colour; write R,G,B from 0 to 1, such as 1,1,1, or one of {names}"
        ) from None
    return red, green, blue


def _say(line: str, code: int) -> int:
    print(printable(line), file=sys.stderr)
    return code


def printable(text: str) -> str:
    """Text of strangers on one line, without what a terminal would take for commands."""
    return _escaped(text).strip()


def _escaped(line: str) -> str:
    return _DIRECTIONS.sub(lambda match: ascii(match[0])[1:-1], _CONTROL.sub(" ", line))


def counted(number: int, thing: str) -> str:
    """A number of things in words: "1 frame", "2 frames"."""
    return f"{number} {thing}" + ("" if number == 1 else "s")


def size_text(count: int) -> str:
    """A size as users read it: bytes, kB (1e3) or MB (1e6)."""
    return f"{count} bytes" if count < 10_000 else f"{count / 1e3:.1f} kB" if count < 1e7 else f"{count / 1e6:.1f} MB"
