"""Closed segments: every one starts from the first keyframe's Gaussians, as a closed GOP of a video starts afresh.

A segment then depends on the first keyframe, the first frame's pictures and those of its own frames and of the next
one's first, and on nothing else, so that segments can be encoded apart from each other (`parts`). Gaussians that never
change have the same bits in the whole stream, across all segments. What one frame hands to the next is made anew where
a segment begins (`StreamState.restart`); its first frame catches up with all that has happened since the stream's first
one, in several rounds of training, each with a search for new objects. The frames before a start go over to it
(`NextSegment`, `training.cross_fade`), so that it does not show. DESIGN.md, "Closed segments", says what depends on
what, and has the figures.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from decogs.codec.state import State, changed_between
from decogs.formats.splats import Splats

from .input.ingest import RigFrame
from .settings.encode import EncodeSettings
from .settings.frame import FrameSettings
from .stream_state import CodedFrame, FrameInWork, StreamState
from .training.cross_fade import CrossFade
from .training.method import TrainedFrame

_MOST = 0.9
"""Share of the next segment in the last frame before it. What is learnt lags behind what is to be learnt."""


def catch_up(
    state: StreamState,
    now: FrameInWork,
    settings: FrameSettings,
    train: Callable[[FrameInWork], TrainedFrame],
) -> TrainedFrame:
    """Trains the first frame of a closed segment in rounds; the last one's result, against the round before it.

    A round that diverges is the last, and changes nothing.
    """
    trained = train(now)
    for _ in range(1, state.settings.catch_up):
        if trained.rejected:
            break
        now = state.rehearse(now, trained, settings)
        trained = replace(train(now), rejected=False)
    return trained


def with_following(
    frames: Iterable[RigFrame], first: int, settings: EncodeSettings
) -> Iterator[tuple[RigFrame, Sequence[RigFrame]]]:
    """Every frame, with those that follow up to the start of the next segment if it goes over to that, else none.

    ``first``: the take's first frame. A take's last segment has none after it.
    """
    waiting: deque[RigFrame] = deque()
    for frame in frames:
        waiting.append(frame)
        left = -(frame.index - first) % settings.segment if settings.fading else 0
        while waiting and (not left or left > settings.fading):
            now = waiting.popleft()
            yield now, tuple(waiting)
    while waiting:
        yield waiting.popleft(), ()


class NextSegment:
    """What the next closed segment shows of the last frames before it, as far as its first frame has the same scene.

    It is trained from its start backwards: ``frames`` are those before it and its first one. ``follow`` trains and
    codes a frame, but for one that shows another scene.
    """

    def __init__(
        self,
        state: StreamState,
        frames: Sequence[RigFrame],
        follow: Callable[[StreamState, RigFrame], CodedFrame | None],
    ) -> None:
        apart = state.apart()
        self.start = frames[-1].index
        self._first: CodedFrame | None = None
        self._scenes: dict[int, tuple[State, Splats]] = {}
        # Frames are counted on from the start, not back, as the state of an encode expects.
        for place, frame in enumerate(reversed(frames)):
            coded = follow(apart, replace(frame, index=self.start + place))
            if coded is None:
                break
            self._first = self._first or coded
            self._scenes[frame.index] = (apart.scene.state, apart.scene.splats)
        state.views.show(state.scene.splats)

    def coded(self, frame: int) -> CodedFrame | None:
        """The segment's first frame as it was coded; None for any other ``frame``."""
        return self._first if frame == self.start else None

    def fade(self, frame: int, state: StreamState) -> CrossFade | None:
        """What ``frame`` goes over to.

        None where the two segments do not show the same scene.
        """
        mine, first, frames = state.scene.state, state.scene.first, state.settings.fading
        old = np.isin(mine.ids, first.ids, assume_unique=True)
        if frame not in self._scenes or not old.any():
            return None
        theirs, splats = self._scenes[frame]
        apart = first.ids[changed_between(first, mine) | changed_between(first, theirs)]
        share = _MOST * (frames + 1 - (self.start - frame)) / frames
        rows = np.flatnonzero(~old | np.isin(mine.ids, apart, assume_unique=True))
        return CrossFade(splats, share, rows, state.fade_views())
