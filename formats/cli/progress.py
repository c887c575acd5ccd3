"""How far a job is: a bar on a terminal, elsewhere a line now and then, so that the log of a long job tells it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TextIO


@dataclass(frozen=True)
class Pace:
    """A line comes after so many ``seconds``, or after a tenth of the work, but never sooner than a ``pause`` after the
    one before it: a short job says nothing.
    """

    seconds: float = 30.0
    pause: float = 2.0


_PACE = Pace()


class Progress(Protocol):
    """Shows one stretch of work until it is closed."""

    def to(self, done: int, total: int, note: str = "") -> None:
        """Units done and units in all, 0 while that is unknown; ``note`` is for a terminal."""

    def rename(self, what: str) -> None:
        """Says what is worked on from now on."""

    def write(self, line: str) -> None:
        """A line of its own."""

    def close(self) -> None:
        """The work is done, or given up."""


def open_progress(stream: TextIO | None, what: str, unit: str, pace: Pace | None = None) -> Progress:
    """Progress of ``what``, counted in ``unit`` ("frame"), on ``stream``; silent for None."""
    if stream is None:
        return _Silent()
    return _Bar(stream, what, unit) if stream.isatty() else Lines(stream, what, unit, pace)


class _Silent:
    def to(self, done: int, total: int, note: str = "") -> None:
        pass

    def rename(self, what: str) -> None:
        pass

    def write(self, line: str) -> None:
        pass

    def close(self) -> None:
        pass


class _Bar:
    def __init__(self, stream: TextIO, what: str, unit: str) -> None:
        self._stream, self._what, self._unit = stream, what, unit
        self._bar: Any = None

    def to(self, done: int, total: int, note: str = "") -> None:
        if self._bar is None:
            from tqdm import tqdm

            self._bar = tqdm(desc=self._what, total=total or None, unit=self._unit, file=self._stream, leave=False)
        self._bar.total = total or None
        self._bar.set_postfix_str(note, refresh=done == self._bar.n)
        self._bar.update(done - self._bar.n)

    def rename(self, what: str) -> None:
        self._what = what
        if self._bar is not None:
            self._bar.set_description(what)

    def write(self, line: str) -> None:
        if self._bar is None:
            print(line, file=self._stream, flush=True)
        else:
            self._bar.write(line, file=self._stream)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


class Lines:
    """``frames: 30 of 300 frames, 1:32 elapsed, about 13:48 left``, after every tenth of the work or 30 seconds."""

    def __init__(
        self,
        stream: TextIO,
        what: str,
        unit: str,
        pace: Pace | None = None,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream, self._what, self._unit, self._clock = stream, what, unit, clock
        self._pace = pace or _PACE
        self._begun = self._written = clock()
        self._tenth = 0

    def to(self, done: int, total: int, note: str = "") -> None:
        now = self._clock()
        tenth = 10 * done // total if total else 0
        if now - self._written >= (self._pace.pause if tenth > self._tenth else self._pace.seconds):
            self._written, self._tenth = now, tenth
            self.write(self._line(done, total, now - self._begun))

    def _line(self, done: int, total: int, elapsed: float) -> str:
        count = f"{done} of {total}" if total else str(done)
        left = f", about {_clock_text(elapsed * (total - done) / done)} left" if 0 < done < total else ""
        return f"{self._what}: {count} {self._unit}s, {_clock_text(elapsed)} elapsed{left}"

    def rename(self, what: str) -> None:
        self._what = what

    def write(self, line: str) -> None:
        print(line, file=self._stream, flush=True)

    def close(self) -> None:
        pass


def _clock_text(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{rest:02}" if minutes >= 60 else f"{minutes}:{rest:02}"
