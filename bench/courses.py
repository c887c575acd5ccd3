"""How the loss falls inside a frame: the gain of training at any moment, the median over a stream's frames."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.encoder.output.convergence_log import ConvergenceLog
from decogs.formats.files.outputs import write_whole

from .estimates import rounded

_LATER = ("cache", "joint")
"""Stages of a later frame's training, as the log calls them."""
_POINTS = 60
"""Points that a course is thinned to: a curve needs no more."""


@dataclass(frozen=True)
class Course:
    """The loss against seconds since a frame's pictures were decoded, wall clock; medians over ``frames`` frames.

    Every loss is the mean over the last ``views`` steps, since each step sees one view and views differ.
    """

    frames: int
    views: int
    seconds: list[float]
    loss: list[float]


@dataclass
class Recording:
    """The losses that an encode logs: the log to give it, and the log's lines once it is over."""

    log: ConvergenceLog
    lines: list[str] = field(default_factory=list)


@contextmanager
def recorded_course() -> Iterator[Recording]:
    """A log for one encode; on disk, and removed, as the encode's own is."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "losses.jsonl"
        with ConvergenceLog(path) as log:
            recording = Recording(log)
            yield recording
        recording.lines = path.read_text("utf-8").splitlines()


def course(lines: Sequence[str], views: int) -> Course | None:
    """The course in a log's lines; None when no later frame was trained for a step of every view.

    Frames stop at different steps: it goes as far as at least half of the frames do, and only those count.
    """
    frames: dict[int, list[tuple[float, float]]] = {}
    for record in map(json.loads, lines):
        if record["stage"] in _LATER:
            frames.setdefault(record["frame"], []).append((record["seconds"], record["loss"]))
    trained = [np.array(steps) for steps in frames.values() if len(steps) >= views]
    if not trained:
        return None
    steps = sorted(len(frame) for frame in trained)[len(trained) // 2]
    counted = [frame[:steps] for frame in trained if len(frame) >= steps]
    seconds = np.median([frame[views - 1 :, 0] for frame in counted], axis=0)
    losses = np.median([_trailing_means(frame[:, 1], views) for frame in counted], axis=0)
    shown = np.unique(np.linspace(0, len(seconds) - 1, _POINTS).round().astype(int))
    return Course(len(counted), views, seconds[shown].tolist(), losses[shown].tolist())


def write_course(path: Path, found: Course) -> None:
    """Writes a course as JSON, whole or not at all. Raises OSError."""
    write_whole(path, (json.dumps(rounded(asdict(found))) + "\n").encode())


def read_course(path: Path) -> Course | None:
    """A course from its file; None when the file is not there or damaged."""
    try:
        return Course(**json.loads(path.read_text("utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def _trailing_means(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    sums = np.cumsum(np.concatenate([[0.0], values]))
    return np.asarray((sums[width:] - sums[:-width]) / width)
