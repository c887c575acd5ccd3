"""Closed segments: every one starts from the first keyframe's Gaussians, as a closed GOP of a video starts afresh.

A segment then depends on the first keyframe, the first frame's pictures and the pictures of its own frames, and on
nothing else, so that segments can be encoded apart from each other (`parts`). Gaussians that never change have the same
bits in the whole stream, across all segments. What one frame hands to the next is made anew where a segment begins
(`StreamState.restart`); its first frame catches up with all that has happened since the stream's first one, in several
rounds of training, each with a search for new objects. DESIGN.md, "Closed segments", says what depends on what, and has
the figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from decogs.formats.errors import UsageError

from .settings.encode import EncodeSettings
from .settings.frame import FrameSettings
from .stream_state import FrameInWork, StreamState
from .training.method import TrainedFrame


def with_closed_segments(settings: EncodeSettings) -> EncodeSettings:
    """The same settings with closed segments; raises UsageError where they would not be independent."""
    if not settings.segment:
        raise UsageError("`closed`: say how many frames a segment has, with `segment`")
    if settings.time_budget is not None:
        raise UsageError(
            "`closed`: `time_budget` carries time from segment to segment, so none stands on its own; drop one of the "
            "two"
        )
    return replace(settings, closed=True)


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
