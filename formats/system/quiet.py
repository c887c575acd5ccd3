"""Keeps OpenCV silent while this library uses it: the user gets one line of ours, not its own."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_lock = Lock()
_users = 0
_level_before = 0


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """OpenCV's log level is 0 inside, whoever else is inside at the same time, and afterwards what it was before."""
    global _users, _level_before
    import cv2

    logging = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 4, 5
    with _lock:
        if not _users:
            _level_before = logging.getLogLevel()
            logging.setLogLevel(0)
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                logging.setLogLevel(_level_before)
