"""What the user sees while an encode works: a bar with the time left on a terminal, JSON lines in a log file."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Any, TextIO

from .json_lines import JsonLines
from .reports import FrameReport


class EncodeProgress:
    """Follows an encode of ``frame_count`` frames.

    ``terminal``: a bar over the look at the rig, one over the keyframe's steps, one over the frames, and a line of
    figures per frame; nothing when it is None or a pipe. ``log``: one JSON object per line, written as things happen:
    "look" (what the rig calls for, where it was looked at), "start", one "frame" per frame (the fields of FrameReport,
    and ``elapsed`` seconds), "end"; ``append``: after what is there. Raises UsageError when it cannot be written.
    """

    def __init__(
        self, frame_count: int, log: Path | None, *, append: bool = False, terminal: TextIO | None = None
    ) -> None:
        self._terminal = terminal if terminal is not None and terminal.isatty() else None
        self._frame_count = frame_count
        self._began = time.perf_counter()
        self._bar: Any = None
        self._keyframe_done = False
        self._log = None if log is None else JsonLines(log, "--log", append=append)

    def __enter__(self) -> EncodeProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close_bar()
        if self._log:
            self._log.__exit__(kind, error, trace)

    def started(self, facts: dict[str, Any]) -> None:
        self._write({"event": "start", **facts})

    def look_step(self, step: int, steps: int) -> None:
        if self._terminal:
            bar = self._bar or self._open_bar("looking", steps, "step")
            bar.update(step - bar.n)

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        """Tells what the rig calls for: the cameras of each effect."""
        self._write({"event": "look", "detected": {effect: list(names) for effect, names in detected.items()}})
        self._close_bar()
        if self._terminal:
            print("calls for " + (", ".join(detected) or "nothing"), file=self._terminal)

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        if self._terminal:
            bar = self._bar or self._open_bar("keyframe", steps, "step")
            bar.update(step - bar.n)
            if step % 50 == 0:
                bar.set_postfix_str(f"loss {loss:.4f}", refresh=False)

    def frame(self, report: FrameReport) -> None:
        self._write({"event": "frame", "elapsed": round(time.perf_counter() - self._began, 3), **asdict(report)})
        if not self._terminal:
            return
        if not self._keyframe_done:
            self._keyframe_done = True
            self._close_bar()
            self._open_bar("frames", self._frame_count, "frame")
        self._bar.write(frame_line(report), file=self._terminal)
        self._bar.update(1)

    def finished(self, facts: dict[str, Any]) -> None:
        self._write({"event": "end", "elapsed": round(time.perf_counter() - self._began, 3), **facts})

    def _open_bar(self, what: str, total: int, unit: str) -> Any:
        from tqdm import tqdm

        self._bar = tqdm(desc=what, total=total, unit=unit, file=self._terminal, leave=False)
        return self._bar

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def _write(self, record: dict[str, Any]) -> None:
        if self._log:
            self._log.write(record)
            self._log.flush()


def frame_line(report: FrameReport) -> str:
    """One frame's figures on one line."""
    held_out = "" if report.held_out_psnr is None else f"  held out {report.held_out_psnr:6.2f} dB"
    stages = "  ".join(f"{name} {seconds:.2f} s" for name, seconds in report.seconds.items() if name != "measure")
    if report.replayed:
        stages = "replayed"
    stages += "  light alone" if report.effects == ["appearance_change"] else ""
    stages += "".join(f"  without {name}: {why}" for name, why in report.left_out.items())
    stages += "  rejected" if report.rejected else ""
    stages += "".join(f"  compensation ended: {fault}" for fault in report.uncorrected)
    stages += "  change missed by the masks" if report.overlooked else ""
    return (
        f"frame {report.frame:4d} {report.kind:5}  train {report.training_psnr:6.2f} dB{held_out}  "
        f"selected {report.selected:6.1%}  {report.bytes:8d} bytes  {stages}"
    )
