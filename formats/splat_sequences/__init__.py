"""Files that hold a whole sequence of Gaussians, one module for each format, read by the packages of their makers.

The packages are no part of an installation: whoever has such files installs what reads them. `opening` finds the
reader by the ending of a file's name; frames come one at a time.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..splats import Splats


@dataclass(frozen=True, eq=False)
class SequenceFrame:
    """One frame: Gaussians, all of them finite, and ``ids`` (N,), which name them over time, each once.

    ``left_out``: how many Gaussians were, and why, a line each.
    """

    splats: Splats
    ids: NDArray[np.int64]
    left_out: tuple[str, ...] = ()


class SplatSequence(Protocol):
    """A file that is open. ``fps``: frames per second; ``up``: the axis that programs take for up in such files."""

    fps: float
    frame_count: int
    up: Literal["Y", "-Y"]

    def frames(self) -> Iterator[SequenceFrame]:
        """The frames in order. Raises UsageError, with the file's name, for what is damaged or takes too much."""
        ...
