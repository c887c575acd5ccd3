"""For how long a camera that is recording is waited for, by a clock of the test's own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.rigs import live
from decogs.formats.rigs.live import LiveSource, _Recording

LATE, PICTURE = 0.5, np.zeros((4, 4, 3), np.uint8)


@dataclass
class Folder:
    """Pictures that have come of a camera."""

    come: set[int] = field(default_factory=set)
    place = advice = "here"

    def reached(self, frame: int) -> bool:
        return any(number >= frame for number in self.come)

    def take(self, frame: int) -> Any:
        return PICTURE if frame in self.come else None

    def holds(self, frame: int) -> bool:
        return False

    is_over = holds

    def why(self, frame: int) -> str:
        return "it is dead"

    def finish(self) -> bool:
        return False

    def close(self) -> None:
        pass


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    now = SimpleNamespace(seconds=0.0)

    def sleep(seconds: float) -> None:
        now.seconds += seconds

    monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: now.seconds, sleep=sleep))
    return now


def test_a_dead_camera_is_not_waited_for_until_it_is_back(clock: SimpleNamespace) -> None:
    """Three frames in a row cost ``late`` each, those after them nothing."""
    dead, other = Folder({0}), Folder({0})
    camera = Camera("dead", 4, 4, 4.0, 4.0, 2.0, 2.0, np.eye(4))
    recording = _Recording({"dead": lambda _: dead}, fps=25.0, late=LATE, end=60.0, every=1, feeds={"other": other})
    pictures = LiveSource(Path("sources.toml"), camera, recording).read(0, 20)
    assert list(waits(pictures, clock, other, range(6))) == pytest.approx([0, LATE, LATE, LATE, 0, 0], abs=0.02)
    assert sorted(recording.dropped) == [1, 2, 3, 4, 5]
    dead.come |= {6, 7}
    assert list(waits(pictures, clock, other, range(6, 9))) == pytest.approx([0, 0, LATE], abs=0.02)


def waits(pictures: Iterator[Any], clock: SimpleNamespace, other: Folder, frames: range) -> Iterator[float]:
    """The seconds that each frame costs, of which the other camera has just taken a picture."""
    for frame in frames:
        other.come.add(frame)
        began = clock.seconds
        next(pictures)
        yield clock.seconds - began
