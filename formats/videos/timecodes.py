"""The timecode that cameras write into their videos: hours, minutes, seconds and frames since midnight.

Source: SMPTE ST 12-1. In drop-frame timecode, whose last mark is ``;`` or ``.``, two numbers of every minute but each
tenth are left out (four at 60 frames a second), so that it keeps up with a clock. There is room for 30 frames in a
second: many recorders of 50 and 60 give two pictures one number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import av

from .reading import opened_video

_TEXT = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d\d)")
_COUNTS = (24, 25, 30, 48, 50, 60, 72, 90, 96, 100, 120, 240)
"""Numbers in a second of timecode."""


@dataclass(frozen=True)
class Timecode:
    """``text`` as written; ``per_second``: how many numbers a second of it has, None where the file does not tell."""

    text: str
    per_second: int | None = None

    @property
    def is_drop_frame(self) -> bool:
        """Whether numbers are left out to keep up with a clock."""
        return self.text[8] != ":"

    @property
    def is_full_hour(self) -> bool:
        """Whether it begins an hour, as editors number every file that they write: no evidence of when it was taken."""
        return self.text[3:8] == "00:00" and self.text[9:] == "00"

    @property
    def frames(self) -> int:
        """The last two digits."""
        return int(self.text[9:])

    def count(self, per_second: int) -> int | None:
        """The numbers since midnight, of ``per_second`` in each second; None where it is no timecode of such."""
        hours, minutes, seconds = (int(self.text[at : at + 2]) for at in (0, 3, 6))
        if hours > 23 or minutes > 59 or seconds > 59 or self.frames >= per_second:
            return None
        minutes += 60 * hours
        return (60 * minutes + seconds) * per_second + self.frames - self._dropped(minutes, per_second)

    def day(self, per_second: int) -> int:
        """The numbers of a day, after which it begins anew."""
        return 86400 * per_second - self._dropped(24 * 60, per_second)

    def _dropped(self, minutes: int, per_second: int) -> int:
        return round(per_second / 15) * (minutes - minutes // 10) if self.is_drop_frame else 0


def timecode_of(text: str, count: int | None = None) -> Timecode | None:
    """The timecode in a text, ``count`` of its numbers after midnight where that is known; None if it is none."""
    if not _TEXT.fullmatch(text):
        return None
    plain = Timecode(text)
    fitting = [per_second for per_second in _COUNTS if count is not None and plain.count(per_second) == count]
    return Timecode(text, fitting[0]) if len(fitting) == 1 else plain


def read_timecode(path: Path) -> Timecode | None:
    """The first timecode that a video's tracks or its container state; None if there is none. Raises RigError."""
    with opened_video(path) as (container, stream):
        for each in (stream, *container.streams, container):
            text = each.metadata.get("timecode")
            if text and _TEXT.fullmatch(text):
                return timecode_of(text, _counted(container))
    return None


def _counted(container: av.container.InputContainer) -> int | None:
    """The number that a .mov or .mp4 has for its first frame; None where it has none.

    Source: QuickTime File Format, timecode media: the track's sample is a number of 32 bits, counted from midnight.
    """
    for track in container.streams.data:
        if "timecode" in track.metadata:
            try:
                data = next((bytes(packet) for packet in container.demux(track) if packet.size), b"")
            except av.FFmpegError:
                return None
            return int.from_bytes(data, "big") if len(data) == 4 else None
    return None
