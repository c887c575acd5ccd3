"""The timecode that cameras write into their videos: hours, minutes, seconds and frames since midnight.

Source: SMPTE ST 12-1. In drop-frame timecode, whose last mark is ``;`` or ``.``, two numbers of every minute but each
tenth are left out (four at 60 frames a second), so that it keeps up with a clock.
"""

from __future__ import annotations

import re
from pathlib import Path

from .videos import opened_video

_TEXT = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)")
_DAY = 24 * 3600


def read_timecode(path: Path) -> str | None:
    """The first timecode that a video's tracks or its container state; None if there is none. Raises RigError."""
    with opened_video(path) as (container, stream):
        stated = [each.metadata.get("timecode") for each in (stream, *container.streams, container)]
    return next((text for text in stated if text and _TEXT.fullmatch(text)), None)


def frames_since_midnight(timecode: str, fps: float) -> int | None:
    """The frames that a timecode counts at ``fps``; None for what is no timecode of that rate."""
    found = _TEXT.fullmatch(timecode)
    nominal = round(fps)
    if found is None or nominal < 1:
        return None
    hours, minutes, seconds, frames = (int(found[group]) for group in (1, 2, 3, 5))
    if hours > 23 or minutes > 59 or seconds > 59 or frames >= nominal:
        return None
    count = ((hours * 60 + minutes) * 60 + seconds) * nominal + frames
    if found[4] != ":":
        passed = hours * 60 + minutes
        count -= round(nominal / 15) * (passed - passed // 10)
    return count


def is_full_hour(timecode: str) -> bool:
    """Whether it begins an hour, as editors number every file that they write: no evidence of when it was taken."""
    return re.fullmatch(r"\d\d:00:00[:;.]00", timecode) is not None


def day_of_frames(fps: float) -> float:
    """The frames of a day, after which a timecode begins anew."""
    return _DAY * fps
