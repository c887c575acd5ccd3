"""A stranger's file tried in a process of its own first, where the library that reads it cannot be trusted with it.

A few wrong bytes make OpenUSD end the process, fill gigabytes from 3 kB, or count for minutes, and Python can neither
catch nor interrupt that. What came through a process with bounded memory and time is read again, in ours. Checking
every length instead would be a second reader, of a format without specification.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..system.operating_systems import limit_process

_SECONDS = 60
"""Of processor time: some ten times what the longest film that is rendered takes."""
_BESIDE = 512 << 20
"""Bytes beside those allowed: Python, numpy and OpenUSD took 130 MiB."""
_REFUSED = 3
_PROGRAM = "import sys; sys.path[:] = sys.argv[2:]; from decogs.formats.files.trial import answer; answer(sys.argv[1])"
_ONE_THREAD = {"PXR_WORK_THREAD_LIMIT": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Each further one would have a stack within the limit."""


def try_apart(read: Callable[..., object], path: Path, *given: Any, max_memory: int) -> None:
    """Calls the module's function ``read`` with ``path`` and ``given``, plain JSON values, in another process.

    Raises UsageError as that does, and where the process crashes or needs more than ``max_memory`` bytes or a minute.
    """
    asked = json.dumps([read.__module__, read.__name__, os.fspath(path), given, max_memory, _SECONDS])
    tried = subprocess.run(
        [sys.executable, "-c", _PROGRAM, asked, *sys.path],
        env=os.environ | _ONE_THREAD,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    if tried.returncode == _REFUSED:
        raise UsageError(json.loads(tried.stdout))
    if tried.returncode:
        raise UsageError(
            f"{path}: is damaged, or needs more than {max_memory >> 20} MiB (`max_memory`) or {_SECONDS} s to be read; "
            "export it again"
        )


def answer(asked: str) -> None:
    """What the other process does."""
    module, name, path, given, max_memory, seconds = json.loads(asked)
    read = getattr(import_module(module), name)
    limit_process(max_memory + _BESIDE, seconds)
    try:
        read(Path(path), *given)
    except UsageError as error:
        print(json.dumps(str(error)), flush=True)
        os._exit(_REFUSED)
    os._exit(0)  # Taking apart what was read may take long, and means nothing.
