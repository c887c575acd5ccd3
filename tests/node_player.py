"""Runs the player's own tests in Node: ``npm ci`` in ``player/`` once, then they run with all others."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

PLAYER = Path(__file__).parents[1] / "player"


def missing_for_player() -> str | None:
    """What the tests need and cannot find; None when all is there."""
    if shutil.which("node") is None:
        return "Node 20 or later"
    if not (PLAYER / "node_modules" / "esbuild").exists():
        return "player/node_modules (npm ci in player/)"
    return None


def run_player_tests(*names: str, environment: Mapping[str, str] | None = None) -> int:
    """The tests whose files have one of these names in theirs, or all; how many passed. Raises when one fails."""
    done = subprocess.run(
        ["node", "tests/run.mjs", *names],
        cwd=PLAYER,
        env=os.environ | (environment or {}),
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    failed = [line.strip() for line in done.stdout.splitlines() if line.strip().startswith(("not ok", "error:"))]
    assert done.returncode == 0, "\n".join([*failed[:60], done.stdout[-2000:], done.stderr[-2000:]])
    counts = [int(line.split()[-1]) for line in done.stdout.splitlines() if line.startswith("# pass ")]
    return counts[0]
