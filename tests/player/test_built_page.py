"""The committed page is what the sources build, and small; building needs Node."""

from __future__ import annotations

import gzip
import re
import subprocess
from pathlib import Path

from decogs.decoder.viewing.page_files import PAGE
from node import PLAYER, node

MOST_BYTES = 170_000
"""Scripts and WebAssembly together, gzipped."""

MOST_FIRST_BYTES = 110_000
"""Of what leads to the first picture and plays, gzipped: page, player, worker, and their WebAssembly."""
PAGE_ITSELF = ("index.html", "decogs-page.css", "decogs-page.js", "decogs-early.js")
FIRST = (*PAGE_ITSELF, "decogs-player.js", "decogs-worker.js", "decogs-kernel.wasm", "decogs-zstd.wasm")


def test_the_page_is_what_the_sources_build(tmp_path: Path) -> None:
    built = tmp_path / "page"
    run = subprocess.run([node(), str(PLAYER / "build.mjs"), str(built)], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    expected = {path.name: path.read_bytes() for path in built.iterdir()}
    found = {path.name: path.read_bytes() for path in PAGE.iterdir()}
    assert sorted(found) == sorted(expected), "make player"
    for name in found:
        assert found[name] == expected[name], f"{name}: make player"


def test_what_browsers_load_is_small() -> None:
    sizes = {path.name: len(gzip.compress(path.read_bytes(), 9)) for path in PAGE.iterdir()}
    assert sum(sizes.values()) <= MOST_BYTES, sizes


def test_the_scripts_that_play_are_small() -> None:
    """Controls come behind the first picture; recorded and exact pictures bring their scripts when asked for."""
    sizes = {name: len(gzip.compress((PAGE / name).read_bytes(), 9)) for name in FIRST}
    assert sum(sizes.values()) <= MOST_FIRST_BYTES, sizes


def test_licences_of_what_is_bundled_are_with_it() -> None:
    """Every package that the sources import, and nothing that was not looked at; engines are their users' own."""
    said = (PAGE / "licences.txt").read_text("utf-8")
    sources = "".join(path.read_text("utf-8") for path in (PLAYER / "src").rglob("*.ts"))
    needed = set(re.findall(r'from "([^."][^"]*)"', sources))
    assert needed == {"zstddec", "three", "playcanvas"}
    for package in needed - {"three", "playcanvas"}:
        node()
        assert (PLAYER / "node_modules" / package / "LICENSE").read_text("utf-8").strip() in said
