"""The clocks of a rig, and the one way from each to the others.

| clock | counts | type |
|---|---|---|
| a camera's own frames | from 0, its first recorded one | `RecordedIndex` |
| the rig's frames | instants that all cameras recorded, from 0 | `RigIndex` |
| a stream's frames | from 0, the first of the rig's that is encoded | `StreamIndex` |
| time in frames of the rig | of the slowest recording, and parts of one | `RigTime` |
| time in seconds | as the recordings count them, exact | `Fraction` |

A stream may be played at another rate than that of its recordings (`Rig.fps`); no clock here depends on that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NewType

RecordedIndex = NewType("RecordedIndex", int)
RigIndex = NewType("RigIndex", int)
StreamIndex = NewType("StreamIndex", int)
RigTime = NewType("RigTime", float)


@dataclass(frozen=True)
class CameraClock:
    """A camera's frame ``first + k * step`` shows the rig's instant k, ``late`` frames of the rig after it."""

    first: RecordedIndex = RecordedIndex(0)
    step: int = 1
    late: RigTime = RigTime(0.0)

    def recorded_index(self, frame: RigIndex) -> RecordedIndex:
        """The camera's frame that shows the rig's ``frame``."""
        return RecordedIndex(self.first + frame * self.step)


@dataclass(frozen=True)
class Timeline:
    """``rate``: the rig's frames in a second, as the slowest camera recorded them; None where nothing tells.

    ``clocks``: by camera; one that is not named has the rig's own frames.
    """

    rate: Fraction | None = None
    clocks: Mapping[str, CameraClock] = field(default_factory=dict)

    def clock(self, camera: str) -> CameraClock:
        """The clock of a camera's own frames."""
        return self.clocks.get(camera, CameraClock())

    def late(self) -> dict[str, float]:
        """By camera, by what part of a frame its pictures are later than their instant, below 0 earlier."""
        return {name: clock.late for name, clock in self.clocks.items() if clock.late}

    def time_of(self, seconds: float | Fraction) -> RigTime:
        """Seconds in frames of the rig. There must be a ``rate``."""
        assert self.rate is not None
        return RigTime(float(Fraction(seconds) * self.rate))

    def seconds_of(self, frames: float) -> Fraction:
        """Frames of the rig in seconds. There must be a ``rate``."""
        assert self.rate is not None
        return Fraction(frames) / self.rate


def rig_index(first: RigIndex, frame: StreamIndex) -> RigIndex:
    """The rig's frame that is a stream's, which begins with the rig's ``first``."""
    return RigIndex(first + frame)
