"""Where commands write."""

from __future__ import annotations

import sys
from io import BytesIO, TextIOWrapper

import pytest

from decogs.formats.command_line import path_or_pipe
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
