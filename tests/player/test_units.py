"""The player's own unit tests, in Node: ``npm ci`` in ``player/`` once, then they run with all others."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

PLAYER = Path(__file__).parents[2] / "player"


def missing() -> str | None:
    """What the tests need and cannot find; None when all is there."""
    if shutil.which("node") is None:
        return "Node 20 or later"
    if not (PLAYER / "node_modules" / "esbuild").exists():
        return "player/node_modules (npm ci in player/)"
    return None


@pytest.mark.skipif(missing() is not None, reason=f"the player's unit tests need {missing()}")
def test_units() -> None:
    done = subprocess.run(
        ["node", "tests/run.mjs"], cwd=PLAYER, capture_output=True, text=True, timeout=600, check=False
    )
    failed = [line.strip() for line in done.stdout.splitlines() if "not ok" in line]
    assert done.returncode == 0, "\n".join([*failed, done.stdout[-4000:], done.stderr[-2000:]])
    assert "\n# pass " in done.stdout
    assert "\n# pass 0\n" not in done.stdout
