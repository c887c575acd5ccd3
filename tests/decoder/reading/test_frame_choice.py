"""Which frames of a stream are asked for, and frames in any order."""

from __future__ import annotations

from typing import Any

import pytest

from decogs.codec.scene.digest import digest
from decogs.decoder.frame_choice import chosen_frames, coming_frames, frames_in_any_order
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import UsageError


@pytest.mark.parametrize("wanted", [range(8), [0, 3, 7], [7, 0, 5, 5, 6, 2], [4, 4, 1]])
def test_frames_come_in_the_order_that_is_asked_for(small_stream: Any, wanted: list[int]) -> None:
    with open_stream(small_stream.path) as stream:
        found = list(frames_in_any_order(stream, wanted))
    assert [frame.index for frame in found] == list(wanted)
    for frame, index in zip(found, wanted, strict=True):
        assert digest(frame.state) == digest(small_stream.states[index])


def test_frames_are_chosen_by_pythons_rules(small_stream: Any) -> None:
    with open_stream(small_stream.path) as stream:
        assert chosen_frames(stream, None) == range(8)
        assert chosen_frames(stream, slice(-3, None)) == range(5, 8)
        assert chosen_frames(stream, range(2, 100)) == range(2, 8)
        for nothing in (slice(8, None), slice(3, 3), slice(-20, -10)):
            with pytest.raises(UsageError, match="nothing to decode, it has frames 0:8; choose other `frames`"):
                chosen_frames(stream, nothing)
        with pytest.raises(UsageError, match="a step is not possible"):
            chosen_frames(stream, slice(0, 8, 2))


def test_of_a_stream_that_grows_frames_count_from_its_start() -> None:
    assert coming_frames(None) == slice(0, None)
    assert coming_frames(slice(3, 5)) == slice(3, 5)
    for impossible in (slice(-1, None), slice(0, -1), slice(4, 4), slice(0, 9, 2)):
        with pytest.raises(UsageError, match="consecutive ones that count from its start"):
            coming_frames(impossible)
