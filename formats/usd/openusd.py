"""OpenUSD's modules, loaded without a signal in between.

While they are set up they swallow and print whatever Python raises, so that Ctrl-C would end nothing and leave a
traceback. A signal that comes meanwhile is raised when they are there.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from ..system.operating_systems import ENDING_SIGNALS


def load_openusd() -> None:
    """Imports all that our files need of it; to be called before ``from pxr import``."""
    with _signals_wait():
        from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdUtils, Vt  # noqa: F401


@contextmanager
def quiet_openusd() -> Iterator[None]:
    """Keeps OpenUSD's warnings from stderr, where they show paths; its errors are exceptions all the same."""
    from pxr import UsdUtils

    taken = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    finally:
        taken.TakeUncoalescedDiagnostics()
        del taken


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Handlers of the process's end are called behind the block. Blocking signals would not do: threads take them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handled = [n for n in (signal.SIGINT, *ENDING_SIGNALS) if callable(signal.getsignal(n))]
    kept = {number: signal.signal(number, lambda number, _: came.append(number)) for number in handled}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])
