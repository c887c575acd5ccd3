"""How the loss falls inside a frame, told from a log of every step."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from decogs.bench.runs.courses import Course, course, read_course, recorded_course, write_course


def log_of(frame: int, losses: list[float], *, every: float = 0.5, stage: str = "joint") -> list[str]:
    return [
        json.dumps({"frame": frame, "stage": stage, "iteration": step, "seconds": every * (step + 1), "loss": loss})
        for step, loss in enumerate(losses)
    ]


def test_a_course_is_the_median_of_means_over_all_views() -> None:
    lines = log_of(1, [4, 2, 2, 0]) + log_of(2, [6, 4, 2, 2]) + log_of(3, [40, 40, 40, 40], every=2.0)
    assert course(lines, views=2) == Course(3, 2, [1.0, 1.5, 2.0], [5.0, 3.0, 2.0])


def test_frames_that_stop_early_do_not_make_it_jump() -> None:
    lines = log_of(1, [1, 1, 1, 1]) + log_of(2, [9, 9]) + log_of(3, [3, 3, 3])
    assert course(lines, views=2) == Course(2, 2, [1.0, 1.5], [2.0, 2.0])


def test_both_stages_of_later_frames_count_and_no_keyframe() -> None:
    lines = log_of(0, [90.0] * 3, stage="keyframe") + log_of(0, [80.0] * 3, stage="settle")
    assert course(lines, views=2) is None
    lines += log_of(1, [4.0, 4.0], stage="cache") + log_of(1, [2.0])
    found = course(lines, views=2)
    assert found is not None
    assert found.loss == [4.0, 3.0]


def test_long_courses_are_thinned_to_their_ends() -> None:
    found = course(log_of(1, [float(step) for step in range(600)]), views=1)
    assert found is not None
    assert len(found.loss) == len(found.seconds) == 60
    assert (found.loss[0], found.loss[-1]) == (0.0, 599.0)


def test_a_course_is_kept_and_a_damaged_one_is_none(tmp_path: Path) -> None:
    path, kept = tmp_path / "run.course.json", Course(2, 12, [0.25, 0.5], [0.1234567, 0.1])
    assert read_course(path) is None
    write_course(path, kept)
    assert read_course(path) == kept
    path.write_text('{"frames": 2}')
    assert read_course(path) is None


def test_a_recording_has_its_lines_once_it_is_over() -> None:
    with recorded_course() as recording:
        recording.log.begin(7)
        recording.log.step("joint", 0, 0.5)
    (line,) = map(json.loads, recording.lines)
    assert (line["frame"], line["stage"], line["loss"]) == (7, "joint", 0.5)
    with pytest.raises(KeyboardInterrupt), recorded_course():
        raise KeyboardInterrupt
