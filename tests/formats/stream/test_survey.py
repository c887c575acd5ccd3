"""Where frames lie: what damage costs frames and what does not, and keyframes around a place."""

from __future__ import annotations

import pytest

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import IndexEntry, PacketKind
from decogs.formats.stream.reasons import Reason
from decogs.formats.stream.survey import Survey, lost_frames_within, survey


def damage(offset: int) -> StreamError:
    return StreamError(Reason.BAD_PAYLOAD_CRC, "damage", offset=offset)


def surveyed(frames: list[int], *damaged: int, keys: tuple[int, ...] = (0,), declared: int = 0) -> Survey:
    """Frame k lies at byte 100 k; damage lies at bytes."""
    entries = [IndexEntry(100 * k, k, PacketKind.KEY if k in keys else PacketKind.DELTA) for k in frames]
    return survey(entries, complete=True, damage=map(damage, damaged), frames_declared=declared)


def test_damage_is_harmless_where_no_frame_is_missing() -> None:
    """Byte 150 is in a place of no frame, 250 and 270 where frame 2 and 3 should be: the first of them is to blame."""
    found = surveyed([0, 1, 4], 50, 150, 250, 450)
    assert [error.offset for error in found.harmless()] == [50, 250, 450]
    assert [found.cause(frame).offset for frame in (2, 3)] == [150, 150]
    assert list(surveyed([0, 1, 2]).harmless()) == []
    assert [error.offset for error in surveyed([0], 50).harmless()] == [50]


def test_a_frame_that_just_is_not_there_is_missing() -> None:
    cause = surveyed([0, 3], 350).cause(1)
    assert (cause.reason, cause.offset) == (Reason.FRAME_ORDER, 300)
    last = surveyed([0, 1], declared=4)
    assert last.frame_count == 4
    assert (last.cause(3).reason, last.cause(3).offset) == (Reason.FRAME_ORDER, None)


def test_keyframes_before_and_after_a_frame_are_others() -> None:
    found = surveyed([0, 1, 3, 4, 6], keys=(0, 3, 6))
    assert [found.keyframe_before(frame) for frame in range(7)] == [None, 0, 0, 0, 3, 3, 3]
    assert [found.keyframe_after(frame) for frame in range(7)] == [3, 3, 3, 6, 6, 6, None]
    assert [found.entry(frame) is None for frame in range(8)] == [False, False, True, False, False, True, False, True]


@pytest.mark.parametrize("frames", [[0, 0], [2, 1]])
def test_frames_that_do_not_rise_are_an_error(frames: list[int]) -> None:
    with pytest.raises(StreamError, match=rf"frame {frames[1]} comes after frame {frames[0]}") as caught:
        surveyed(frames)
    assert caught.value.reason == Reason.FRAME_ORDER


def test_so_many_frames_may_be_missing_as_there_is_stream_for() -> None:
    assert lost_frames_within(1) == 1024 + 64
    assert surveyed([0], declared=1 + 1088).frame_count == 1089
    with pytest.raises(StreamError, match="1089 frames are missing, above the limit of 1088 for the 1 that are there"):
        surveyed([0], declared=1 + 1089)
