"""Where the commands begin: Ctrl-C ends them in one line, from the first moment to the last.

Modules take a while to load, and Python reports a Ctrl-C meanwhile, and one while the process ends, with a traceback.
Nothing is written then, so the process can end at once. In between Ctrl-C is a KeyboardInterrupt, as ever.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from functools import partial
from importlib import import_module
from types import FrameType
from typing import NoReturn

INTERRUPTED = 130


def _run(module: str, main: str) -> int:
    """Loads a command's module and runs it; returns its exit code."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        # Ignored, as in the background of a script.
        return int(getattr(import_module(module), main)())
    signal.signal(signal.SIGINT, _end)
    command = getattr(import_module(module), main)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        return int(command())
    except KeyboardInterrupt:
        _end()
    finally:
        signal.signal(signal.SIGINT, _end)


def _end(number: int = signal.SIGINT, frame: FrameType | None = None) -> NoReturn:
    with suppress(OSError):
        os.write(2, f"{os.path.basename(sys.argv[0])}: interrupted\n".encode(errors="replace"))
    os._exit(INTERRUPTED)


analyze = partial(_run, "decogs.encoder.analysis.commands", "analyze_main")
bench = partial(_run, "decogs.encoder.bench.commands", "bench_main")
decode = partial(_run, "decogs.decoder.commands", "decode_main")
encode = partial(_run, "decogs.encoder.commands", "encode_main")
export = partial(_run, "decogs.decoder.commands", "export_main")
info = partial(_run, "decogs.decoder.commands", "info_main")
join = partial(_run, "decogs.encoder.commands", "join_main")
pack = partial(_run, "decogs.encoder.commands", "pack_main")
view = partial(_run, "decogs.decoder.commands", "view_main")
