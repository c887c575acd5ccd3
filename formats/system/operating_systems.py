"""What Windows does in another way than Linux and macOS: locks of files, flags, signals, limits of a process."""

from __future__ import annotations

import os
import signal
import sys
import threading

if sys.platform == "win32":
    import msvcrt

    _FAR = 1 << 62
    """Where a lock lies: Windows keeps others from reading what is locked, and no file is so long."""
else:
    import fcntl
    import resource

ENDING_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""With which a system asks a process to end."""

AS_THEY_ARE = getattr(os, "O_BINARY", 0)
"""Flag of `os.open`: bytes, where ends of lines would be translated."""
WITHOUT_WAITING = getattr(os, "O_NONBLOCK", 0)
"""Flag of `os.open`: a named pipe's other end is not waited for."""
NO_LINKS = getattr(os, "O_NOFOLLOW", 0)
"""Flag of `os.open`: a link is refused."""

_reading = threading.Lock()

CLOSES_FIRST = sys.platform == "win32"
"""Whether a file that is open can neither be renamed nor removed."""


def take_lock(number: int, *, shared: bool = False) -> None:
    """Takes the lock of an open file; BlockingIOError when another process has it, OSError where there are no locks.

    ``shared``: others may have it in the same way (not on Windows).
    """
    if sys.platform == "win32":
        at = os.lseek(number, 0, os.SEEK_CUR)
        os.lseek(number, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(number, msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(*error.args) from None
        finally:
            os.lseek(number, at, os.SEEK_SET)
    else:
        fcntl.flock(number, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)


def read_at(number: int, count: int, offset: int) -> bytes:
    """Bytes of an open file from a place of it; where others read meanwhile, on Windows they do so by this, too."""
    if sys.platform != "win32":
        return os.pread(number, count, offset)
    with _reading:
        os.lseek(number, offset, os.SEEK_SET)
        return os.read(number, count)


def limit_process(memory: int, seconds: int) -> None:
    """Bounds this process: bytes of memory, seconds of processor time, and no core dump. Windows has no such bounds."""
    if sys.platform != "win32":
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))


def address_space() -> int | None:
    """Bytes of addresses that this process may use; None where there is no limit."""
    if sys.platform == "win32":
        return None
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if allowed == resource.RLIM_INFINITY else allowed
