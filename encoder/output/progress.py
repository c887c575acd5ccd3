"""What the user sees while an encode works: a bar with the time left, and a line of figures per frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, TextIO

from .observer import EncodeObserver
from .reports import FrameReport


class TerminalProgress(EncodeObserver):
    """Shows an encode's progress on ``terminal``, and nothing where that is none, such as a pipe; a context manager.

    A bar over the look at the rig, one over the keyframe's steps, one over the frames, and a line of figures per frame.
    """

    def __init__(self, terminal: TextIO) -> None:
        self._terminal = terminal if terminal.isatty() else None
        self._frame_count: int | None = None
        self._bar: Any = None
        self._keyframe_done = False

    def __enter__(self) -> TerminalProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close_bar()

    def look_step(self, step: int, steps: int) -> None:
        if self._terminal:
            bar = self._bar or self._open_bar("analysing", steps, "step")
            bar.update(step - bar.n)

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        self._close_bar()
        if self._terminal:
            print("effects: " + (", ".join(detected) or "none"), file=self._terminal)

    def started(self, facts: Mapping[str, Any]) -> None:
        first, stop = facts["frames"]
        self._frame_count = stop - first
        if self._terminal and "memory" in facts:
            print(f"memory: up to {facts['memory'] / 2**30:.1f}G", file=self._terminal)

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        if self._terminal and self._keyframe_done:
            self._bar.set_postfix_str(f"keyframe of another scene {step}/{steps}" if step < steps else "")
        elif self._terminal:
            bar = self._bar or self._open_bar("keyframe", steps, "step")
            bar.update(step - bar.n)
            if step % 50 == 0:
                bar.set_postfix_str(f"loss {loss:.4f}", refresh=False)

    def frame(self, report: FrameReport) -> None:
        if not self._terminal:
            return
        if not self._keyframe_done:
            self._keyframe_done = True
            self._close_bar()
            self._open_bar("frames", self._frame_count, "frame")
        self._bar.write(frame_line(report), file=self._terminal)
        self._bar.update(1)

    def _open_bar(self, what: str, total: int | None, unit: str) -> Any:
        from tqdm import tqdm

        self._bar = tqdm(desc=what, total=total, unit=unit, file=self._terminal, leave=False)
        return self._bar

    def _close_bar(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


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
    stages += "  change missed by the masks" if report.overlooked else ""
    return (
        f"frame {report.frame:4d} {report.kind:5}  train {report.training_psnr:6.2f} dB{held_out}  "
        f"selected {report.selected:6.1%}  {report.bytes:8d} bytes  {stages}"
    )
