"""Streams in scenes of the oldest and the newest releases of engines that @decogs/player names as its peers.

Needs Node, npm and its registry, and Chromium.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from node import PLAYER, node

NO_CHROMIUM = 77
PEERS = json.loads((PLAYER / "package.json").read_text())["peerDependencies"]


@pytest.mark.browser
@pytest.mark.parametrize("end", ["oldest", "newest"])
def test_streams_are_drawn_and_refused_as_they_are_to_be(end: str, tmp_path: Path) -> None:
    program = node()
    engines, data = tmp_path / "engines", tmp_path / "data"
    engines.mkdir()
    wanted = [f"{name}@{allowed if end == 'newest' else oldest(allowed)}" for name, allowed in PEERS.items()]
    got = subprocess.run(
        ["npm", "install", "--no-audit", "--no-fund", *wanted], cwd=engines, capture_output=True, text=True, check=False
    )
    if got.returncode:
        pytest.skip(f"the registry gives no engines: {got.stderr.strip().splitlines()[-1]}")
    script = Path(__file__).with_name("browser_data.py")
    subprocess.run([sys.executable, str(script), str(data)], check=True, capture_output=True)
    run = subprocess.run(
        [program, str(PLAYER / "tests/browser/run.mjs"), str(data), "engines"],
        env=os.environ | {"DECOGS_ENGINES": str(engines)},
        capture_output=True,
        text=True,
        check=False,
    )
    if run.returncode == NO_CHROMIUM:
        pytest.skip(run.stderr.strip())
    assert run.returncode == 0, f"{wanted}: {run.stdout}{run.stderr}"


def oldest(allowed: str) -> str:
    """The lowest version of a range that states it first."""
    found = re.match(r">=(\S+)", allowed)
    assert found is not None, allowed
    return found.group(1)
