"""``decogs.decoder.view`` in a notebook: a kernel runs the cell, and Chromium shows what is beneath it.

Needs nbclient, nbconvert and ipykernel, which no extra brings: ``pip install --target FOLDER nbclient nbconvert
ipykernel`` and ``PYTHONPATH=FOLDER``. Skipped without them, Node or Chromium.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from node import PLAYER, node

STREAM = Path(__file__).parents[1] / "canary" / "arc.dgs"
NO_CHROMIUM = 77


@pytest.mark.browser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_notebook_shows_the_player_beneath_its_cell(tmp_path: Path) -> None:
    nbformat: Any = pytest.importorskip("nbformat")
    nbclient: Any = pytest.importorskip("nbclient")
    nbconvert: Any = pytest.importorskip("nbconvert")
    pytest.importorskip("ipykernel")
    program = node()
    source = f"from decogs.decoder import view\nview({str(STREAM)!r}, height=300)"
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    client = nbclient.NotebookClient(notebook, timeout=60, kernel_name="python3")
    page = tmp_path / "notebook.html"

    async def shown() -> subprocess.CompletedProcess[str]:
        async with client.async_setup_kernel():  # the server lives as long as the kernel
            await client.async_execute_cell(notebook.cells[0], 0)
            page.write_text(nbconvert.HTMLExporter().from_notebook_node(notebook)[0], "utf-8")
            command = [program, str(PLAYER / "tests/browser/notebook.mjs"), str(page)]
            return await asyncio.to_thread(subprocess.run, command, capture_output=True, text=True, timeout=150)

    run = asyncio.run(shown())
    if run.returncode == NO_CHROMIUM:
        pytest.skip("Chromium is not installed")
    assert run.returncode == 0, run.stderr
    told = json.loads(run.stdout)
    assert (told["frame"], told["error"], told["clientHeight"]) == (0, None, 300)
    assert told["clientWidth"] > 500
