"""What a file can make a library do in another process is one line here."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

from decogs.formats.errors import UsageError
from decogs.formats.files.trial import try_apart

READERS = """
import os, time
from decogs.formats.errors import UsageError

def well(path, *given): assert (str(path), given) == ("a\\udcff.usdc", (None, 2.5))
def refused(path, *given): raise UsageError(f"{path}: \\N{SNOWMAN} is wrong")
def crashes(path, *given): os.abort()
def spins(path, *given):
    while True: pass
def hoards(path, *given): bytearray(600 << 20)
"""
ODD = Path("a\udcff.usdc")


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Callable[..., object]]:
    (tmp_path / "readers_tried_apart.py").write_text(READERS)
    monkeypatch.syspath_prepend(tmp_path)
    return lambda name: getattr(import_module("readers_tried_apart"), name)


def test_what_goes_well_says_nothing(reader: Callable[[str], Callable[..., object]]) -> None:
    try_apart(reader("well"), ODD, None, 2.5, max_memory=1 << 20)


def test_what_it_refuses_is_refused_in_its_words(reader: Callable[[str], Callable[..., object]]) -> None:
    with pytest.raises(UsageError) as refusal:
        try_apart(reader("refused"), ODD, max_memory=1 << 20)
    assert str(refusal.value) == "a\udcff.usdc: \N{SNOWMAN} is wrong"


@pytest.mark.parametrize("what", ["crashes", "spins", "hoards"])
def test_what_ends_or_exceeds_it_is_one_line(
    reader: Callable[[str], Callable[..., object]], what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """512 MiB are beside the limit, and 600 are asked for."""
    monkeypatch.setattr("decogs.formats.files.trial._SECONDS", 2)
    begun = time.monotonic()
    with pytest.raises(UsageError, match=r"needs more than 1 MiB \(`max_memory`\) or 2 s to be read"):
        try_apart(reader(what), ODD, max_memory=1 << 20)
    assert time.monotonic() - begun < 60


def test_nothing_of_the_folder_it_is_called_in_is_loaded(
    reader: Callable[[str], Callable[..., object]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    well = reader("well")
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "json.py").write_text("open('run', 'w')\n")
    monkeypatch.chdir(tmp_path / "here")
    try_apart(well, ODD, None, 2.5, max_memory=1 << 20)
    assert not (tmp_path / "here" / "run").exists()
