"""Keeps OpenCV and its FFmpeg silent while this library uses them: the user gets one line of ours, not theirs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

_FFMPEG_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"
_QUIET = "-8"

_lock = Lock()
_users = 0
_level_before = 0
_ffmpeg_before: str | None = None


@contextmanager
def quiet_opencv() -> Iterator[None]:
    """OpenCV's log level is 0 inside, whoever else is inside at the same time, and afterwards what it was before.

    FFmpeg's level is looked up once in a process, when the first video is opened: whoever does that inside has it quiet
    from then on, unless the environment says otherwise.
    """
    global _users, _level_before, _ffmpeg_before
    import cv2

    logging = cv2 if hasattr(cv2, "setLogLevel") else cv2.utils.logging  # OpenCV 4, 5
    with _lock:
        if not _users:
            _level_before, _ffmpeg_before = logging.getLogLevel(), os.environ.get(_FFMPEG_LEVEL)
            logging.setLogLevel(0)
            os.environ.setdefault(_FFMPEG_LEVEL, _QUIET)
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                logging.setLogLevel(_level_before)
                if _ffmpeg_before is None:
                    os.environ.pop(_FFMPEG_LEVEL, None)
