"""The loss inside each frame against time: its quality at any moment, as JSON lines."""

from __future__ import annotations

import time
from pathlib import Path

from .json_lines import JsonLines


class ConvergenceLog(JsonLines):
    """Writes one JSON object per training step to ``path``, those of a frame when it is over.

    ``frame``: the rig's index; ``seconds``: since the frame's pictures were decoded; ``stage``: "keyframe", "settle"
    (the keyframe's, on its lattice), "cache" or "joint" (stages 1 and 2 of a later frame), "fade" (of one that
    is faded into the next closed segment); ``iteration``: within the stage, from 0; ``loss``: of the one view that the
    step drew, before it. Views differ: a mean over as many iterations as there are views is a steadier curve.
    ``append``: after what is there. Raises UsageError when the file cannot be written.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        super().__init__(path, "convergence_log", append=append)
        self._frame, self._began = 0, 0.0

    def begin(self, frame: int) -> None:
        """Begins a frame, whose pictures are there; lines of the frame before it can be read from now on."""
        self.flush()
        self._frame, self._began = frame, time.perf_counter()

    def step(self, stage: str, iteration: int, loss: float) -> None:
        """Writes a step of the frame that was begun: its stage, its number there from 0, and the loss before it."""
        record = {
            "frame": self._frame,
            "stage": stage,
            "iteration": iteration,
            "seconds": round(time.perf_counter() - self._began, 6),
            "loss": loss,
        }
        self.write(record)
