"""What a child process prints on a chosen instruction set: a process keeps the one that its first kernel took."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


def printed_on(instruction_set: str, *arguments: str) -> str:
    """What ``python ARGUMENTS`` prints there, stripped; skips the test where this machine lacks the instruction set."""
    run = subprocess.run(
        [sys.executable, *arguments],
        env={**os.environ, "DECOGS_INSTRUCTION_SET": instruction_set},
        capture_output=True,
        text=True,
        check=False,
    )
    if "UsageError" in run.stderr and "this machine runs" in run.stderr:
        pytest.skip(f"this machine does not run {instruction_set}")
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()
