"""Node for tests of the player, which are skipped where it, or what it needs, is not installed."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

PLAYER = Path(__file__).parents[1] / "player"


def node() -> str:
    """Node's program; skips the test without it or without the player's packages (``make player`` gets them)."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("Node is not installed")
    if not (PLAYER / "node_modules").is_dir():
        pytest.skip("player/node_modules is missing: make player")
    return program


def run_player_tests(*parts: str, **environment: str) -> None:
    """Runs the player's unit tests whose names have one of ``parts`` in them."""
    run = subprocess.run(
        [node(), str(PLAYER / "tests" / "run.mjs"), *parts],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
