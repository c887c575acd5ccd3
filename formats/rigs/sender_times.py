"""When the pictures of cameras that send were taken, on one clock, so that those of one instant get one number.

By the sender's clock where the connection tells it (RTCP sender reports), unless that is not set: then, and where
nothing tells it, by when a picture arrives. Of many arrivals the least delayed says where the sender's time stamps
stand on this machine's clock. Stamps count on from there; a clock that has run apart by most of a frame is set anew,
so that one frame is dropped or lacking.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

_SETTLING = 1.0
"""Seconds of arrivals before the first picture is placed: what was held up while connecting came at once."""
_UNTIL_REPORT = 6.0
"""The same where the sender may still tell its clock: RTCP reports come every five seconds at most."""
_WINDOW = 10.0
"""Seconds of arrivals; the one with the least delay sets the clock."""
_RUN_APART = 0.75
"""Frames from where a picture was placed to where the clock puts it, beyond which it is placed anew."""
_CLOCK_NOT_SET = 5.0
"""Seconds between sending and arriving beyond which the sender's clock is another one."""
_LEAP = 5.0
"""Seconds by which stamps leap against arrivals where a sender begins anew."""


@dataclass(frozen=True)
class CaptureTime:
    """When a picture was taken, seconds on the recording's clock; ``since``: the time that its stamps count from."""

    since: float
    at: float

    def frame(self, zero: float, fps: float) -> int:
        """Its number, where frame 0 is at ``zero``; the distance of two stamps is never rounded in two ways."""
        return round((self.since - zero) * fps) + round((self.at - self.since) * fps)


class SharedClock:
    """Where frame 0 is: when the last of the cameras that are ``expected`` sent its first picture."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._expected: set[str] = set()
        self._begun: dict[str, float] = {}
        self._zero: float | None = None

    def expect(self, name: str) -> None:
        """A camera that is recording."""
        with self._lock:
            self._expected.add(name)

    def begin(self, name: str, at: float) -> None:
        """The time of a camera's first picture; later calls do not count."""
        with self._lock:
            self._begun.setdefault(name, at)
            if self._zero is None and self._expected <= self._begun.keys():
                self._zero = max(self._begun.values())

    @property
    def zero(self) -> float | None:
        """Seconds; None until all cameras have begun."""
        return self._zero


class StampsOfFile:
    """Time stamps of a video that is being written: its first picture is frame 0."""

    def __init__(self) -> None:
        self._first: float | None = None

    def locate(self, stamp: float, sent: float | None, now: float) -> CaptureTime:
        """Where a picture is; ``sent`` and ``now`` do not matter."""
        self._first = stamp if self._first is None else self._first
        return CaptureTime(0.0, stamp - self._first)


class StampsOfSender:
    """Time stamps of one connection to a camera."""

    def __init__(self, fps: float, *, reports: bool) -> None:
        self._fps, self._settling = fps, _UNTIL_REPORT if reports else _SETTLING
        self._delays: list[tuple[float, float]] = []
        self._offset: float | None = None
        self._since = 0.0
        self._last: tuple[float, float] | None = None

    def locate(self, stamp: float, sent: float | None, now: float) -> CaptureTime | None:
        """Where a picture is, seconds since 1970; None while that is not known.

        ``stamp``: the sender's, in seconds; ``sent``: the same on the sender's clock, where that is known; ``now``.
        """
        if self._last is not None and abs((stamp - self._last[0]) - (now - self._last[1])) > _LEAP:
            self._offset, self._delays, self._settling = None, [], _SETTLING
        self._last = stamp, now
        if sent is not None and abs(sent - now) < _CLOCK_NOT_SET:
            self._settle(sent - stamp, stamp)
        else:
            self._delays.append((now, now - stamp))
            waited = now - self._delays[0][0]
            if waited >= (self._settling if self._offset is None else _WINDOW):
                self._settle(min(delay for _, delay in self._delays), stamp)
                self._delays = []
        return None if self._offset is None else CaptureTime(self._since, stamp + self._offset)

    def _settle(self, offset: float, stamp: float) -> None:
        if self._offset is None or abs(offset - self._offset) * self._fps > _RUN_APART:
            self._offset, self._since = offset, stamp + offset
