"""Where commands write."""

from __future__ import annotations

import errno
import os
import sys
from io import BytesIO, TextIOWrapper

import pytest

from decogs.formats.cli.command_line import TRY_AGAIN, Parser, path_or_pipe, print_text, retryable, warn_as
from decogs.formats.errors import UsageError


def test_a_path_stays_as_it_is() -> None:
    assert path_or_pipe("x.dgs", "the stream") == "x.dgs"


def test_a_pipe_is_the_bytes_of_standard_output(monkeypatch: pytest.MonkeyPatch) -> None:
    written = BytesIO()
    monkeypatch.setattr(sys, "stdout", TextIOWrapper(written))
    assert path_or_pipe("-", "the stream") is written


def test_neither_a_terminal_nor_a_closed_output_takes_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = TextIOWrapper(BytesIO())
    monkeypatch.setattr(terminal, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys, "stdout", terminal)
    with pytest.raises(UsageError, match="the stream would go to the terminal"):
        path_or_pipe("-", "the stream")
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(UsageError, match="standard output is closed"):
        path_or_pipe("-", "the stream")


@pytest.mark.parametrize("given", [["--frames", "-3:"], ["--frames", "-3:-1"], ["--only", "-2:"], ["--up", "-Y"]])
def test_values_may_begin_with_a_dash(given: list[str]) -> None:
    parser = Parser(prog="x")
    for option in ("--frames", "--only", "--up"):
        parser.add_argument(option)
    option, value = given
    assert getattr(parser.parse_args(given), option[2:]) == value


@pytest.mark.parametrize("given", [["--frames", "--up", "Y"], ["--frames", "-q"], ["--frames"]])
def test_an_option_is_no_value(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    parser = Parser(prog="x")
    parser.add_argument("--frames")
    parser.add_argument("--up")
    parser.add_quiet()
    with pytest.raises(SystemExit, match="2"):
        parser.parse_args(given)
    assert capsys.readouterr().err == "x: error: argument --frames: expected one argument (see x --help)\n"


def test_names_of_strangers_cannot_turn_what_is_printed_round(capsys: pytest.CaptureFixture[str]) -> None:
    """Directions, ends of lines and a terminal's commands, wherever they come: in texts, warnings and errors."""
    name = "exe\u202efdp.\u2066a\u2069\u200f\u2028\x1b[31m\x85"
    shown = r"exe\u202efdp.\u2066a\u2069\u200f\u2028 [31m "
    parser = Parser(prog="x")
    print_text(f"{name}\n  row two")
    warn_as(parser)(name)
    with pytest.raises(SystemExit, match="2"):
        parser.parse_args([name])
    captured = capsys.readouterr()
    assert captured.out == f"{shown}\n  row two\n"
    assert captured.err.splitlines() == [
        f"x: warning: {shown.strip()}",
        f"x: error: unrecognized arguments: {shown} (see x --help)",
    ]


def test_behind_two_dashes_are_files() -> None:
    parser = Parser(prog="x")
    parser.add_argument("files", nargs="*")
    assert parser.parse_args(["--", "--frames", "-3:"]).files == ["--frames", "-3:"]


@pytest.mark.parametrize(("names", "whose"), [(("cam00/0001.png",), "cam00/0001.png: "), ((), f"[Errno {errno.EIO}] ")])
def test_what_a_disk_fails_in_is_named_and_may_be_tried_again(
    names: tuple[str, ...], whose: str, capsys: pytest.CaptureFixture[str]
) -> None:
    problem = os.strerror(errno.EIO)

    def command() -> int:
        raise OSError(errno.EIO, problem, *names)

    assert retryable(Parser(prog="decogs-encode"), command) == TRY_AGAIN
    assert capsys.readouterr().err == f"decogs-encode: {whose}{problem}; nothing was written, try again\n"
