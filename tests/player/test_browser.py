"""The player in a real browser; player/tests/browser has the tests, browser_data.py what they play."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from node import PLAYER, node

NO_CHROMIUM = 77
MOST_SECONDS = 1800
RIGS = [Path(path) for path in os.environ.get("DECOGS_BROWSER_RIGS", "").split(os.pathsep) if path]
"""More streams whose first four frames are compared, cam00's without a lens: `DECOGS_BROWSER_RIGS=a.dgs:b.dgs`."""


@pytest.mark.browser
def test_in_a_browser(tmp_path: Path) -> None:
    program = node()
    script = Path(__file__).with_name("browser_data.py")
    made = subprocess.run([sys.executable, str(script), str(tmp_path), *map(str, RIGS)], capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    script = PLAYER / "tests/browser/run.mjs"
    run = subprocess.run([program, str(script), str(tmp_path)], capture_output=True, text=True, timeout=MOST_SECONDS)
    if run.returncode == NO_CHROMIUM:
        pytest.skip(run.stderr.strip())
    print(run.stdout)
    assert run.returncode == 0, run.stdout + run.stderr
