"""Where the commands begin: Ctrl-C ends them in one line, from the first moment to the last.

Modules take a while to load, and Python reports a Ctrl-C meanwhile, and one while the process ends, with a traceback.
Nothing is written then, so the process can end at once. In between Ctrl-C is a KeyboardInterrupt, as ever.

Loads next to nothing itself: what is interrupted before that nobody can catch. Of 120 Ctrl-C in a wheel's first 0.3 s
of a busy machine 97 end in our line, 13 before Python handles them, and 10 in its start, with its traceback; 39 where
the script is of pip 23, which loads `re` first. An editable install looks for us with a finder, for longer than that.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]
import os
import sys

TYPE_CHECKING = False  # That of typing takes longer to load than all the rest.
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import NoReturn

INTERRUPTED = 130


def _end(*_: object) -> NoReturn:
    try:
        os.write(2, f"{os.path.basename(sys.argv[0])}: interrupted\n".encode(errors="replace"))
    finally:
        os._exit(INTERRUPTED)


def _is_ours() -> bool:
    """Whether Ctrl-C is to end the process: it is not ignored, as in the background of a script."""
    return _signal.getsignal(_signal.SIGINT) in (_signal.default_int_handler, _end)


# From here on: this module is the first thing that a script loads, and `signal` itself takes a while.
if os.path.basename(sys.argv[0]).startswith("decogs-") and _is_ours():
    _signal.signal(_signal.SIGINT, _end)

import signal  # noqa: E402
from importlib import import_module  # noqa: E402


def _run(module: str, main: str) -> int:
    """Loads a command's module and runs it; returns its exit code."""
    if not _is_ours():
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


def _command(module: str, main: str) -> Callable[[], int]:
    return lambda: _run(f"decogs.{module}", main)


analyze = _command("encoder.analyze_command", "analyze_main")
bench = _command("bench.commands", "bench_main")
calibrate = _command("rig.calibration.commands", "calibrate_main")
decode = _command("decoder.commands", "decode_main")
edit = _command("decoder.editing.commands", "edit_main")
encode = _command("encoder.commands", "encode_main")
export = _command("decoder.commands", "export_main")
info = _command("decoder.commands", "info_main")
join = _command("encoder.parts.commands", "join_main")
make = _command("takes.commands", "make_main")
report = _command("takes.commands", "report_main")
pack = _command("encoder.packing.commands", "pack_main")
sync = _command("rig.synchronisation.commands", "sync_main")
verify = _command("takes.commands", "verify_main")
view = _command("decoder.commands", "view_main")
