"""A command in a process of its own, which ends when the process that began it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

_PROGRAM = "from decogs.takes.child import main; main()"


def run_command(line: Sequence[str], folder: Path, *, shown: bool) -> tuple[int, str]:
    """Runs one of this package's commands in ``folder``; returns its exit code and the last line that it said.

    ``shown``: what it says goes to the terminal instead.
    """
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM, *line],
        cwd=folder,
        stdin=subprocess.PIPE,  # never written to: its end is ours
        stdout=None if shown else subprocess.DEVNULL,
        stderr=None if shown else subprocess.PIPE,
        text=True,
        errors="replace",
    )
    with process:
        said = "" if process.stderr is None else process.stderr.read().strip()
        code = process.wait()
    return code, said.splitlines()[-1] if said else ""


def main() -> None:
    """What the other process does."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from decogs import entry

    sys.argv[:] = sys.argv[1:]
    sys.exit(getattr(entry, sys.argv[0].removeprefix("decogs-"))())


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
