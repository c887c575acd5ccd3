"""An encode's progress for its user: a bar, and on a terminal a line of figures per frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, TextIO

from decogs.formats.cli.command_line import size_text
from decogs.formats.cli.progress import Pace, Progress, open_progress

from .observer import EncodeObserver
from .reports import FrameReport
from .whole import FRAMES_KNOWN, whole_of

_LEAST_FRAMES = 20
"""Of an encode that is foretold."""


class TerminalProgress(EncodeObserver):
    """Shows an encode's progress on ``stream``; silent for None; a context manager.

    The analysis of the rig, then the keyframe's steps, then the frames: on a terminal a bar for each and a line of
    figures per frame, elsewhere a line now and then. ``endless``: nobody knows yet how many frames there will be.
    """

    def __init__(self, stream: TextIO | None, *, endless: bool = False, pace: Pace | None = None) -> None:
        self._stream, self._endless, self._pace = stream, endless, pace
        self._terminal = stream if stream is not None and stream.isatty() else None
        self._frames, self._asked = 0, range(0)
        self._first: list[FrameReport] = []
        self._progress: Progress | None = None

    def __enter__(self) -> TerminalProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def look_step(self, step: int, steps: int) -> None:
        self._open("analysing", "step").to(step, steps)

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        self._close()
        if self._terminal:
            print("effects: " + (", ".join(detected) or "none"), file=self._terminal)

    def started(self, facts: Mapping[str, Any]) -> None:
        self._asked = range(*facts["frames"])
        if self._terminal and "memory" in facts:
            print(f"memory: up to {facts['memory'] / 2**30:.1f}G", file=self._terminal)

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        if self._frames:
            note = f"keyframe of another scene {step}/{steps}" if step < steps else ""
            self._open("frames", "frame").to(self._frames, self._total, note)
        else:
            self._open("keyframe", "step").to(step, steps, f"loss {loss:.4f}")

    def frame(self, report: FrameReport) -> None:
        if not self._frames:
            self._close()
        progress = self._open("frames", "frame")
        self._frames += report.frame in self._asked  # A part's first keyframe is another part's.
        if len(self._first) < FRAMES_KNOWN and not report.replayed:
            self._first.append(report)
            self._forecast(progress)
        progress.to(self._frames, self._total)
        if self._terminal:
            progress.write(frame_line(report))

    def _forecast(self, progress: Progress) -> None:
        """Says what all of it will take, once some frames are known, of an encode that has many more."""
        if len(self._first) < FRAMES_KNOWN or self._total < _LEAST_FRAMES or self._first[0].kind != "key":
            return
        size, cpu = whole_of(self._first, self._total)
        progress.write(
            f"about {size_text(round(size.low))} to {size_text(round(size.high))}, {cpu.low:.0f} to {cpu.high:.0f} "
            f"CPU-s in all"
        )

    @property
    def _total(self) -> int:
        return 0 if self._endless else len(self._asked)

    def _open(self, what: str, unit: str) -> Progress:
        if self._progress is None:
            self._progress = open_progress(self._stream, what, unit, self._pace)
        return self._progress

    def _close(self) -> None:
        if self._progress is not None:
            self._progress.close()
            self._progress = None


def frame_line(report: FrameReport) -> str:
    """One frame's figures on one line."""
    held_out = "" if report.held_out_psnr is None else f"  held out {report.held_out_psnr:6.2f} dB"
    held_out += "" if report.scale == 1 else f" at scale {report.scale:g}"
    if report.held_out_own_size_psnr is not None:
        held_out += f", {report.held_out_own_size_psnr:.2f} dB at the cameras' own size"
    stages = "  ".join(f"{name} {seconds:.2f} s" for name, seconds in report.seconds.items() if name != "measure")
    if report.replayed:
        stages = "replayed"
    stages += "  light alone" if report.effects == ["appearance_change"] else ""
    stages += "".join(f"  without {name}: {why}" for name, why in report.left_out.items())
    stages += "  rejected" if report.rejected else ""
    stages += "".join(f"  compensation ended: {fault}" for fault in report.uncorrected)
    stages += "  another scene" if report.cut else ""
    stages += "  full-frame change" if report.full_frame_change else ""
    return (
        f"frame {report.frame:4d} {report.kind:5}  train {report.training_psnr:6.2f} dB{held_out}  "
        f"selected {report.selected:6.1%}  {report.bytes:8d} bytes  {stages}"
    )
