"""What the user sees while a report's runs go on: how many frames of all of them are done, and a line for each run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TextIO

from decogs.formats.cli.progress import open_progress

from .run import Run


class BenchProgress:
    """Follows runs of ``frames`` frames in all on ``stream``; silent for None."""

    def __init__(self, frames: int, stream: TextIO | None) -> None:
        self._done, self._frames = 0, frames
        self._progress = open_progress(stream if frames else None, "", "frame")

    def __enter__(self) -> BenchProgress:
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.close()

    def started(self, rig: str, variant: str) -> None:
        self._progress.rename(f"{rig} {variant}")

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        self._progress.to(self._done, self._frames, "" if step == steps else f"keyframe {step}/{steps}")

    def frame(self) -> None:
        self._done += 1
        self._progress.to(self._done, self._frames)

    def finished(self, run: Run) -> None:
        self.measured(
            run.rig, f"{run.variant}, seed {run.seed}", [frame.psnr for frame in run.frames if frame.psnr is not None]
        )

    def measured(self, rig: str, variant: str, psnr: Sequence[float]) -> None:
        """A line on an encode's quality: the mean of its frames' PSNR, dB."""
        mean = math.fsum(psnr) / len(psnr) if psnr else math.nan
        self._progress.write(f"{rig} {variant}: {len(psnr)} frames, {mean:.2f} dB")
