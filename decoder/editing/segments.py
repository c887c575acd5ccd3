"""Choices of Gaussians for a segment as a whole: one that is chosen in any of its frames is chosen in all.

A segment is read twice, once to choose and once to go on with; what was chosen in the last two is kept, so that several
such operations behind each other read the take once more each, and not twice as often each.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.state import Rows, State, same_scene

from .take import Frame, Take

Choices = Callable[[State], Sequence[NDArray[np.bool_]]]
"""Which Gaussians (N,) of a scene are chosen, for each of several reasons."""


def with_choices(take: Take, choose: Choices) -> Callable[[int, int], Iterator[tuple[Frame, tuple[Rows, ...]]]]:
    """Reads frames, each with the ids that are chosen in any frame of its segment, rising, for each reason."""

    @lru_cache(maxsize=2)
    def chosen(start: int, stop: int) -> tuple[Rows, ...]:
        ids: list[Rows] = []
        before: State | None = None
        for frame in take.read(start, stop):
            if before is None or not same_scene(before, frame.state):
                here = [frame.state.ids[rows] for rows in choose(frame.state)]
                ids = [np.union1d(*both) for both in zip(ids, here, strict=True)] if ids else here
            before = frame.state
        return tuple(ids)

    def read(start: int, stop: int) -> Iterator[tuple[Frame, tuple[Rows, ...]]]:
        while start < stop:
            segment = segment_of(take, start)
            ids, end = chosen(segment.start, segment.stop), min(stop, segment.stop)
            for frame in take.read(start, end):
                yield frame, ids
            start = end

    return read


def segment_of(take: Take, frame: int) -> range:
    """The frames of the segment in which a frame lies."""
    number = bisect_right(take.starts, frame)
    return range(take.starts[number - 1], take.starts[number] if number < len(take.starts) else take.frame_count)


def rows_among(state: State, ids: Rows) -> NDArray[np.bool_]:
    """Which of a scene's Gaussians (N,) have one of these ids."""
    return np.isin(state.ids, ids, assume_unique=True)
