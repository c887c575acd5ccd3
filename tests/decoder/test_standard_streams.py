"""Standard streams that are closed or full: one line and code 2, and no file gets their number."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from decogs.formats.cli.command_line import number, number_of_threads, whole_number


def run(module: str, main: str, *arguments: str | Path, closed: tuple[int, ...] = (), **given: Any) -> tuple[int, str]:
    """A command in a process of its own, without these streams; its exit code and what it says on stderr."""

    def close() -> None:
        for stream in closed:
            os.close(stream)

    code = f"import sys; from decogs.{module} import {main}; sys.exit({main}())"
    ran = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=given.pop("stdout", subprocess.DEVNULL),
        stderr=subprocess.PIPE,
        preexec_fn=close,
        text=True,
        timeout=120,
        **given,
    )
    return ran.returncode, ran.stderr


@pytest.fixture
def stream(tmp_path: Path) -> Path:
    """Nothing that could be read: what is wrong with the standard streams is said before."""
    (tmp_path / "s.dgs").write_bytes(b"")
    return tmp_path / "s.dgs"


@pytest.mark.parametrize(
    ("module", "main", "options"),
    [
        ("decoder.commands", "info_main", []),
        ("encoder.commands", "encode_main", ["-o", "-"]),
        ("encoder.commands", "encode_main", ["-o", "x.dgs"]),
    ],
)
def test_a_closed_standard_output_is_one_line(stream: Path, module: str, main: str, options: list[str]) -> None:
    code, said = run(module, main, stream, *options, closed=(1,))
    assert code == 2
    assert said.endswith("error: standard output is closed; send it to a file, or to /dev/null\n")
    assert said.count("\n") == 1


def test_a_closed_standard_input_is_one_line_where_it_is_asked_for(stream: Path) -> None:
    code, said = run("decoder.commands", "decode_main", "-", "--view", "a", "-o", stream.parent / "x", closed=(0,))
    assert (code, said.count("\n")) == (2, 1)
    assert "-: standard input is closed; pipe a stream into it, or name a file" in said
    code, said = run("decoder.commands", "info_main", stream, closed=(0,))
    assert (code, "s.dgs" in said) == (2, True), "it gets as far as the file"


def test_nothing_goes_to_standard_output_in_place_of_a_closed_stderr(stream: Path) -> None:
    """An encode to a pipe prints its summary there: in the stream it would be damage."""
    with (stream.parent / "out").open("wb") as out:
        code, _ = run("decoder.commands", "info_main", stream, closed=(2,), stdout=out)
    assert (code, (stream.parent / "out").read_bytes()) == (2, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize(("unbuffered", "named"), [("", "standard output: "), ("1", "")])
def test_a_full_standard_output_is_one_line(unbuffered: str, named: str) -> None:
    code = (
        "import sys; from decogs.formats.cli.command_line import Parser, run; "
        "sys.exit(run(Parser(prog='x'), lambda: print('figures')))"
    )
    with Path("/dev/full").open("wb") as full:
        ran = subprocess.run(
            [sys.executable, "-c", code],
            stdout=full,
            stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            text=True,
            timeout=120,
        )
    said = f"x: error: {named}No space left on device; make room, or write elsewhere\n"
    assert (ran.returncode, ran.stderr) == (2, said)


@pytest.mark.parametrize("read", [number, whole_number, number_of_threads])
@pytest.mark.parametrize("text", ["١", "１", "1_0", "", "x", "1" * 400 + "x"])
def test_numbers_are_in_ascii_digits(read: Callable[[str], float], text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match=r"is no (whole )?number"):
        read(text)
    assert read("12") == 12
