"""Progress where stderr is no terminal: a line now and then."""

from __future__ import annotations

import io
import sys

import pytest

from decogs.formats.cli.command_line import progress
from decogs.formats.cli.progress import Lines, Pace


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def lines_of(steps: int, seconds: float, total: int | None = None) -> list[str]:
    """What work of so many steps, each of so many seconds, prints."""
    stream, clock = io.StringIO(), Clock()
    shown = Lines(stream, "decoding", "frame", Pace(), clock=clock)
    for step in range(1, steps + 1):
        clock.now += seconds
        shown.to(step, steps if total is None else total)
    shown.close()
    return stream.getvalue().splitlines()


def test_a_line_for_every_tenth() -> None:
    lines = lines_of(100, 1.0)
    assert lines[0] == "decoding: 10 of 100 frames, 0:10 elapsed, about 1:30 left"
    assert lines[-1] == "decoding: 100 of 100 frames, 1:40 elapsed"
    assert len(lines) == 10


def test_a_line_every_thirty_seconds_where_a_tenth_takes_longer() -> None:
    lines = lines_of(1000, 10.0)
    assert lines[0] == "decoding: 3 of 1000 frames, 0:30 elapsed, about 2:46:10 left"
    assert 10_000 // 30 <= len(lines) <= 10_000 // 30 + 10, "and for each tenth"


def test_no_more_than_a_line_every_two_seconds() -> None:
    assert lines_of(10, 0.19) == [], "a short job says nothing"
    assert len(lines_of(10, 1.0)) == 5


def test_without_a_known_end_lines_come_by_time_alone() -> None:
    assert lines_of(61, 1.0, total=0) == ["decoding: 30 frames, 0:30 elapsed", "decoding: 60 frames, 1:00 elapsed"]


def test_a_job_of_nothing() -> None:
    assert lines_of(0, 1.0) == []


def test_commands_tell_progress_unless_they_are_quiet(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("decogs.formats.cli.progress._PACE", Pace(pause=0.0))
    for quiet in (False, True):
        with progress("packing", quiet=quiet) as on_frame:
            on_frame(1, 1)
        sys.stderr.flush()
        assert capfd.readouterr() == ("", "" if quiet else "packing: 1 of 1 frames, 0:00 elapsed\n")
