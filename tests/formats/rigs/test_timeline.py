"""The clocks of a rig, and the way from each to the others."""

from __future__ import annotations

from fractions import Fraction

from decogs.formats.rigs.timeline import (
    CameraClock,
    RecordedIndex,
    RigIndex,
    RigTime,
    RowTimes,
    StreamIndex,
    Timeline,
    rig_index,
)


def test_a_camera_that_records_more_often_shows_an_instant_in_every_nth_frame_from_its_first() -> None:
    clock = CameraClock(RecordedIndex(3), step=2)
    assert [clock.recorded_index(RigIndex(frame)) for frame in (0, 1, 4)] == [3, 5, 11]


def test_a_camera_that_is_not_named_has_the_rigs_own_frames() -> None:
    timeline = Timeline(clocks={"a": CameraClock(late=RigTime(0.25)), "b": CameraClock(RecordedIndex(7))})
    assert timeline.clock("c").recorded_index(RigIndex(9)) == 9
    assert timeline.clock("b").recorded_index(RigIndex(9)) == 16
    assert timeline.row_times() == {"a": RowTimes(RigTime(0.25))}


def test_seconds_and_frames_are_exact() -> None:
    timeline = Timeline(Fraction(30000, 1001))
    assert timeline.seconds_of(30000) == 1001
    assert timeline.time_of(Fraction(1001, 30000)) == 1.0


def test_a_streams_first_frame_is_the_rigs_from_which_it_begins() -> None:
    assert rig_index(RigIndex(12), StreamIndex(3)) == 15
