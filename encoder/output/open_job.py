"""An encode's progress as lines that farms read: Open Job Description's, which other workers parse as well.

Source: Open Job Description specification, "How Jobs Are Run", section on the standard output of actions.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TextIO

from decogs.formats.cli.command_line import printable

from .observer import EncodeObserver
from .reports import FrameReport


class OpenJobProgress(EncodeObserver):
    """Writes ``openjd_progress: 0..100`` and ``openjd_status: TEXT`` to ``output`` as things happen.

    The keyframe's training is as much as a quarter of the whole, where there is any.
    """

    _KEYFRAME = 25.0

    def __init__(self, output: TextIO) -> None:
        self._output, self._frames, self._done = output, range(0), 0
        self._from = 0.0
        self._last_percent = -1

    def look_step(self, step: int, steps: int) -> None:
        if step == 1:
            self._status("analysing the rig")

    def started(self, facts: Mapping[str, Any]) -> None:
        self._frames = range(*facts["frames"])
        first, last = self._frames[0], self._frames[-1]
        self._status(f"encoding frame {first}" if first == last else f"encoding frames {first} to {last}")

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        if not self._done:  # That of another scene is one of the frames.
            self._from = self._KEYFRAME
            self._progress(self._from * step / steps)

    def frame(self, report: FrameReport) -> None:
        self._done += report.frame in self._frames
        self._progress(self._from + (100 - self._from) * self._done / len(self._frames))

    def finished(self, facts: Mapping[str, Any]) -> None:
        self._progress(100.0)

    def failed(self, problem: str) -> None:
        """Says in one line why the encode ends."""
        self._say(f"openjd_fail: {problem}")

    def _status(self, text: str) -> None:
        self._say(f"openjd_status: {text}")

    def _progress(self, percent: float) -> None:
        if int(percent) > self._last_percent:
            self._last_percent = int(percent)
            self._say(f"openjd_progress: {percent:.1f}")

    def _say(self, line: str) -> None:
        # A line break in a file's name would begin a line of its own, which a farm would follow.
        print(printable(line), file=self._output, flush=True)
