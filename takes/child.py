"""A command in a process of its own, which ends when the process that began it does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

_PROGRAM = "from decogs.takes.child import main; main()"


class Ran(NamedTuple):
    """A command's exit ``code``, what it printed, and the last line of what it said on stderr where nobody saw that."""

    code: int
    printed: str
    said: str


def run_command(line: Sequence[str], folder: Path, *, shown: bool) -> Ran:
    """Runs one of this package's commands in ``folder``. ``shown``: what it says on stderr goes to ours."""
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as printed:
        process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, *line],
            cwd=folder,
            stdin=subprocess.PIPE,  # never written to: its end is ours
            stdout=printed,
            stderr=None if shown else subprocess.PIPE,
            text=True,
            errors="replace",
        )
        with process:
            said = "" if process.stderr is None else process.stderr.read().strip()
            code = process.wait()
        printed.seek(0)
        return Ran(code, printed.read(), said.splitlines()[-1] if said else "")


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
