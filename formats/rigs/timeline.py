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
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import NewType

import numpy as np
from numpy.typing import NDArray

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
class RowTimes:
    """When the rows of a camera's pictures are taken, in frames of the rig after a picture's instant.

    ``late``: the middle row. ``readout``: the last row less the first one, below 0 where it is read from below.
    """

    late: RigTime = RigTime(0.0)
    readout: RigTime = RigTime(0.0)

    def at(self, share: NDArray[np.floating]) -> NDArray[np.floating]:
        """Of rows at this share of the picture's height, 0 at its top and 1 at its foot."""
        return self.late + self.readout * (share - 0.5)


@dataclass(frozen=True)
class Timeline:
    """``rate``: the rig's frames in a second, as the slowest camera recorded them; None where nothing tells.

    ``clocks``: by camera; one that is not named has the rig's own frames. ``readouts``: by camera, see `RowTimes`; one
    that is not named takes all rows at once.
    """

    rate: Fraction | None = None
    clocks: Mapping[str, CameraClock] = field(default_factory=dict)
    readouts: Mapping[str, RigTime] = field(default_factory=dict)

    def clock(self, camera: str) -> CameraClock:
        """The clock of a camera's own frames."""
        return self.clocks.get(camera, CameraClock())

    def row_times(self) -> dict[str, RowTimes]:
        """By camera, of those whose rows are not all taken at their picture's instant."""
        none = RigTime(0.0)
        times = {
            name: RowTimes(self.clock(name).late, self.readouts.get(name, none))
            for name in {**self.clocks, **self.readouts}
        }
        return {name: each for name, each in times.items() if each != RowTimes()}

    def with_readouts(self, seconds: Mapping[str, float]) -> Timeline:
        """With these cameras' readouts in place of others; 0 takes all rows at once. There must be a ``rate``."""
        stated = {**self.readouts, **{name: self.time_of(each) for name, each in seconds.items()}}
        return replace(self, readouts={name: readout for name, readout in stated.items() if readout})

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
