"""What ends a frame's training early: a schedule made to fit a deadline, and a target in the pictures."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from decogs.encoder.settings.frame import IterationSettings
from decogs.encoder.training.schedule import (
    MIN_SEARCH_SHARE,
    MIN_STEPS,
    SearchTime,
    StepSchedule,
    StoppingRule,
    TargetWatch,
    brighter_iteration_factor,
    iteration_factor,
    search_of,
)

SCHEDULE, MARKS = 150, (37, 75, 76)


class Clock:
    """Stands still unless told."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(time, "perf_counter", clock)
    return clock


def run(schedule: StepSchedule, step: Callable[[int], None]) -> tuple[list[float], list[int]]:
    """Positions at which steps were made, and the step at which each mark was reached."""
    positions: list[float] = []
    reached: list[int] = []
    while not schedule.is_over:
        reached += [len(positions)] * sum(schedule.reaches(mark) for mark in MARKS)
        positions.append(schedule.position)
        step(len(positions) - 1)
        schedule.step()
    return positions, reached


# The schedule


def test_without_a_deadline_every_step_is_made() -> None:
    positions, reached = run(StepSchedule(SCHEDULE), lambda step: None)
    assert positions == list(range(SCHEDULE))
    assert reached == list(MARKS)


@pytest.mark.parametrize(("factor", "steps"), [(0.5, 75), (2.0, 300)])
def test_a_factor_makes_the_schedule_longer_or_shorter_with_every_mark_at_its_share(factor: float, steps: int) -> None:
    positions, reached = run(StepSchedule(SCHEDULE, factor=factor), lambda step: None)
    assert len(positions) == steps
    np.testing.assert_allclose(reached, np.multiply(MARKS, factor), atol=1)


def test_a_deadline_ends_a_schedule_made_longer(clock: Clock) -> None:
    def step(_: int) -> None:
        clock.now += 0.01

    deadline = clock.now + 0.01 * 200
    positions, reached = run(StepSchedule(SCHEDULE, deadline, factor=3.0), step)
    assert len(positions) == pytest.approx(200, abs=2)
    np.testing.assert_allclose(reached, np.multiply(MARKS, 200 / SCHEDULE), atol=2)


@pytest.mark.parametrize(("missed", "factor"), [(0.0, 0.6), (0.15, 1.0), (0.3, 2.0), (0.9, 3.0)])
def test_what_is_missed_more_than_usual_gets_as_much_longer(missed: float, factor: float) -> None:
    views = [np.full((3, pixels), 0.09, np.float32) for pixels in (400, 600)]
    for view in views:
        view[1, : round(missed * view.shape[1])] = -0.11
    assert iteration_factor(IterationSettings(usual_miss=0.15, min_factor=0.6), 100, views) == pytest.approx(factor)
    for usual in (250, 400, 1000):
        found = iteration_factor(IterationSettings(usual_miss=0.15, min_factor=0.6), usual, views)
        assert found == pytest.approx(min(factor, max(1, 400 / usual)))
    assert iteration_factor(IterationSettings(), 100, views) == 1
    assert iteration_factor(IterationSettings(usual_miss=0.15), 100, [np.zeros((3, 0), np.float32)]) == 1


@pytest.mark.parametrize(("missed", "factor"), [(0.06, 0.6), (0.09, 1.08), (0.15, 3.0), (0.18, 4.32), (0.9, 6.0)])
def test_a_stage_gets_more_than_that(missed: float, factor: float) -> None:
    view = np.full((3, 1000), 0.09, np.float32)
    view[1, : round(missed * view.shape[1])] = -0.11
    settings = IterationSettings(usual_miss=0.15, min_factor=0.6)
    assert iteration_factor(settings, 60, [view], on_stage=True) == pytest.approx(factor, rel=0.01)
    assert iteration_factor(settings, 240, [view], on_stage=True) == pytest.approx(min(factor, 2), rel=0.01)


@pytest.mark.parametrize(("usual", "steps"), [(30, 180), (120, 720), (250, 750), (1000, 1000)])
def test_a_light_that_steps_do_not_follow_gets_more_of_them(usual: int, steps: int) -> None:
    assert usual * brighter_iteration_factor(usual) == pytest.approx(steps)


@pytest.mark.parametrize("fitting", [20, 50, 100])
def test_a_deadline_is_met_with_every_mark_at_its_share_of_the_steps(clock: Clock, fitting: int) -> None:
    def step(_: int) -> None:
        clock.now += 0.01

    deadline = clock.now + 0.01 * fitting
    positions, reached = run(StepSchedule(SCHEDULE, deadline), step)
    assert clock.now == pytest.approx(deadline, abs=0.01), "one step"
    assert reached == pytest.approx([mark * fitting / SCHEDULE for mark in MARKS], abs=1.5)
    assert np.ptp(np.diff(positions)[1:]) < 0.2, "even strides once the first step has told its time"
    assert positions[-1] > SCHEDULE * (1 - 1.5 / fitting), "rates fall all the way"


def test_a_machine_that_slows_down_is_followed(clock: Clock) -> None:
    def step(index: int) -> None:
        clock.now += 0.01 if index < 40 else 0.03

    deadline = clock.now + 1.0
    _, reached = run(StepSchedule(SCHEDULE, deadline), step)
    assert clock.now == pytest.approx(deadline, abs=0.03)
    assert reached == sorted(reached)
    assert len(reached) == len(MARKS)


def test_one_slow_step_does_not_make_the_others_look_slow(clock: Clock) -> None:
    def step(index: int) -> None:
        clock.now += 0.3 if index == 10 else 0.01

    deadline = clock.now + 1.0
    positions, _ = run(StepSchedule(SCHEDULE, deadline), step)
    assert clock.now == pytest.approx(deadline, abs=0.01)
    assert len(positions) == pytest.approx(71, abs=1)


def test_the_relative_stride_is_one_unless_a_deadline_is_short(clock: Clock) -> None:
    """Exactly 1, which leaves the rates as they are, unless the deadline makes strides longer."""
    for factor in (1.0, 3.0, 0.7):
        for deadline in (None, clock.now + 1e3):
            schedule = StepSchedule(SCHEDULE, deadline, factor=factor)
            for _ in range(20):
                assert schedule.relative_stride == 1.0
                schedule.step()
    schedule = StepSchedule(SCHEDULE, clock.now + 0.01 * 15)
    for _ in range(8):
        clock.now += 0.01
        schedule.step()
    assert schedule.relative_stride == pytest.approx(10, rel=0.05)


@pytest.mark.parametrize(("seconds", "truncated"), [(0.1, True), (0.25, False), (10.0, False)])
def test_too_few_steps_leave_a_frame_unfinished_and_a_shorter_schedule_does_not(
    clock: Clock, seconds: float, truncated: bool
) -> None:
    """With the least steps of 150 a frame is truncated; with 25 it is finished, and so is one with all steps."""
    schedule = StepSchedule(SCHEDULE, clock.now + seconds)
    run(schedule, lambda step: setattr(clock, "now", clock.now + 0.01))
    assert schedule.is_truncated == truncated


def test_a_short_schedule_run_whole_is_not_truncated(clock: Clock) -> None:
    schedule = StepSchedule(5, clock.now + 10)
    run(schedule, lambda step: setattr(clock, "now", clock.now + 0.01))
    assert not schedule.is_truncated


def test_time_enough_changes_nothing(clock: Clock) -> None:
    positions, _ = run(StepSchedule(SCHEDULE, clock.now + 1e3), lambda step: None)
    assert positions == list(range(SCHEDULE))


@pytest.mark.parametrize("late", [0.0, 5.0])
def test_a_deadline_gone_by_leaves_a_few_steps_with_all_that_belongs_to_them(clock: Clock, late: float) -> None:
    def step(_: int) -> None:
        clock.now += 0.01

    positions, reached = run(StepSchedule(SCHEDULE, clock.now - late), step)
    assert len(positions) == MIN_STEPS
    assert len(reached) == len(MARKS)


def test_what_is_put_off_costs_no_steps(clock: Clock) -> None:
    def step(index: int) -> None:
        clock.now += 0.01
        if index == 10:
            clock.now += 0.4
            schedule.extend_deadline(0.4)

    schedule = StepSchedule(SCHEDULE, clock.now + 0.5)
    positions, _ = run(schedule, step)
    assert len(positions) == pytest.approx(50, abs=1)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_skipping_leaves_out_what_lies_between(factor: float) -> None:
    schedule = StepSchedule(SCHEDULE, factor=factor)
    positions, reached = run(schedule, lambda step: schedule.skip_to(75) if step == 10 else None)
    assert reached == [11, 11 + np.ceil(factor)], "all but the first mark"
    assert positions[10:12] == [10 / factor, 75]
    assert len(positions) == 11 + (SCHEDULE - 75) * factor + (factor == 0.5) / 2


def test_a_stage_gets_its_share_of_what_is_left(clock: Clock) -> None:
    assert StoppingRule(clock.now + 10).deadline_before(150, 100) == clock.now + 6
    assert StoppingRule(clock.now + 10).deadline_before(0, 0) == clock.now
    assert StoppingRule().deadline_before(150, 100) is None


@pytest.mark.parametrize("seconds", [0.01, 0.2, 3.0])
def test_searching_takes_its_share_on_average_and_begins_at_once(seconds: float) -> None:
    search, spent, when = SearchTime(), 0.0, []
    for frame in range(200):
        search = search.save(1.0, MIN_SEARCH_SHARE)
        if search.affordable_share(MIN_SEARCH_SHARE):
            search = search.spend(seconds, MIN_SEARCH_SHARE)
            spent += seconds
            when.append(frame)
    assert when[0] == 0
    assert spent / 200 == pytest.approx(min(seconds, 0.1), abs=seconds / 100)
    assert np.ptp(np.diff(when[1:])) <= 1, "evenly"


@pytest.mark.parametrize("left", [0.5, 1.0, 2.0, 8.0])
def test_a_search_is_as_large_as_there_is_time_for(left: float) -> None:
    """A whole one takes ten seconds: none may take what many frames have for their steps, the first included."""
    search, taken = SearchTime(), []
    for _ in range(100):
        search = search.save(left, 10.0)
        share = search.affordable_share(10.0)
        taken.append(10 * share)
        if share:
            search = search.spend(10 * share, share)
    assert sum(taken) / (100 * left) == pytest.approx(0.1, rel=0.2)
    assert max(taken) <= max(left, 10 * MIN_SEARCH_SHARE) * 1.001
    assert taken[0] == pytest.approx(max(10 * MIN_SEARCH_SHARE, 0.1 * left))


def test_a_share_of_a_search_has_fewer_views_and_fewer_rays() -> None:
    for views in (4, 12, 31):
        assert search_of(1.0, views) == (views, 1.0)
        for share in (MIN_SEARCH_SHARE, 0.25, 0.5):
            looked, rays = search_of(share, views)
            assert min(views, 8) <= looked <= views
            assert looked * rays == pytest.approx(share * views), "the pairs of a ray and a view"
    assert search_of(0.25, 32) == (16, 0.5)


def test_with_time_for_it_the_first_search_is_a_whole_one() -> None:
    assert SearchTime().save(100.0, 10.0).affordable_share(10.0) == 1.0


def test_without_time_there_is_no_search() -> None:
    assert not SearchTime().save(-1.0, 1.0).affordable_share(1.0)


# The target


def pictures(views: int) -> list[np.ndarray]:
    return [np.full((3, 4, 5), 0.5, np.float32) for _ in range(views)]


def off(by: float) -> np.ndarray:
    return np.full((3, 4, 5), 0.5 + by, np.float32)


def test_a_target_is_reached_when_all_views_together_are_close_enough() -> None:
    """An error of 0.1 everywhere is 20 dB."""
    for target, enough in ((19.9, True), (20.1, False)):
        watch = TargetWatch(target, pictures(3), [None, None, None])
        assert [watch.update(view, off(0.1)) for view in (2, 0, 1)] == [False, False, enough]
    watch = TargetWatch(20.1, pictures(2), [None, None])
    assert not watch.update(0, off(0.13))
    assert watch.update(1, off(0.0)), "what one view lacks the other makes up for"
    assert not watch.update(1, off(0.1))
    assert watch.update(0, off(0.09)), "every view as it was last drawn"


def test_regions_alone_count_and_views_without_one_are_not_waited_for() -> None:
    region = np.zeros((4, 5), bool)
    region[1, 2:4] = True
    shown = off(0.3)
    shown[:, region] = 0.5
    watch = TargetWatch(60.0, pictures(2), [region, np.zeros((4, 5), bool)])
    assert watch.update(0, shown)
    shown[1, 1, 2] = 0.6
    assert not watch.update(0, shown)
    nowhere = TargetWatch(1.0, pictures(1), [np.zeros((4, 5), bool)])
    assert not nowhere.update(0, off(0.0)), "nothing to look at is nothing reached"


def test_colours_beyond_white_count_as_white() -> None:
    watch = TargetWatch(60.0, [np.ones((3, 4, 5), np.float32)], [None])
    assert watch.update(0, np.full((3, 4, 5), 1.4, np.float32))


def test_a_restart_waits_for_all_views_again() -> None:
    watch = TargetWatch(20.0, pictures(2), [None, None])
    assert [watch.update(view, off(0.0)) for view in (0, 1)] == [False, True]
    watch.restart()
    assert [watch.update(view, off(0.0)) for view in (1, 1, 0)] == [False, False, True]
