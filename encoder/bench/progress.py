"""What the user sees while a report's runs go on: one bar over the frames of all of them, a line for each when done."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TextIO

from .runs import Run


class BenchProgress:
    """Follows runs of ``frames`` frames in all; on a terminal, and nothing in a pipe or for None."""

    def __init__(self, frames: int, terminal: TextIO | None) -> None:
        self._bar: Any = None
        self._terminal = terminal
        if terminal is not None and terminal.isatty() and frames:
            from tqdm import tqdm

            self._bar = tqdm(total=frames, unit="frame", file=terminal, leave=False)

    def __enter__(self) -> BenchProgress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def started(self, rig: str, variant: str) -> None:
        if self._bar is not None:
            self._bar.set_description(f"{rig} {variant}")

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        if self._bar is not None:
            self._bar.set_postfix_str("" if step == steps else f"keyframe {step}/{steps}")

    def frame(self) -> None:
        if self._bar is not None:
            self._bar.set_postfix_str("", refresh=False)
            self._bar.update(1)

    def finished(self, run: Run) -> None:
        self.measured(run.rig, run.variant, [frame.psnr for frame in run.frames if frame.psnr is not None])

    def measured(self, rig: str, variant: str, psnr: Sequence[float]) -> None:
        """A line on an encode's quality: the mean of its frames' PSNR, dB."""
        if self._bar is not None:
            mean = math.fsum(psnr) / len(psnr) if psnr else math.nan
            self._bar.write(f"{rig} {variant}: {len(psnr)} frames, {mean:.2f} dB", file=self._terminal)
