"""The reckoning of long takes on many machines (tests/bench/scale.py): what must hold whatever its constants are."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from scale import (
    SECOND_THREAD,
    Machine,
    Take,
    finished,
    keyframe_wall,
    part_walls,
    simulate,
    slots,
    sped_up,
)

TAKE = Take(cameras=18, width=1352, height=1014, minutes=1.0)
MACHINE = Machine(cores=2, memory=16e9, threads=2)


def test_one_machine_does_one_part_after_the_other() -> None:
    found = simulate(TAKE, MACHINE, 1)
    parts = part_walls(TAKE, MACHINE)
    assert len(parts) == 30
    assert found.wall == pytest.approx(keyframe_wall(TAKE, MACHINE) + sum(parts) + TAKE.join_cpu)


def test_any_number_of_machines_waits_for_keyframe_longest_part_and_join() -> None:
    longest = keyframe_wall(TAKE, MACHINE) + max(part_walls(TAKE, MACHINE)) + TAKE.join_cpu
    assert simulate(TAKE, MACHINE, 30).wall == pytest.approx(longest)
    assert simulate(TAKE, MACHINE, 1000).wall == pytest.approx(longest)
    assert simulate(TAKE, MACHINE, 29).wall > longest


def test_more_machines_are_never_slower_and_work_as_much() -> None:
    found = [simulate(TAKE, MACHINE, machines) for machines in range(1, 40)]
    assert all(one.wall >= other.wall for one, other in pairwise(found))
    assert len({(each.cpu, each.read) for each in found}) == 1


@pytest.mark.parametrize("machines", [1, 7, 30])
def test_a_lost_part_costs_at_most_its_time(machines: int) -> None:
    whole, lost = (simulate(TAKE, MACHINE, machines, lost=count) for count in (0, 1))
    assert whole.wall <= lost.wall <= whole.wall + max(part_walls(TAKE, MACHINE)) + 1e-6
    assert lost.cpu > whole.cpu


def test_shorter_parts_end_sooner_and_work_more() -> None:
    shorter = replace(TAKE, segment=15)
    assert simulate(shorter, MACHINE, 1000).wall < simulate(TAKE, MACHINE, 1000).wall
    assert simulate(shorter, MACHINE, 1000).cpu > simulate(TAKE, MACHINE, 1000).cpu


def test_memory_bounds_what_runs_side_by_side() -> None:
    assert slots(TAKE, Machine(cores=16, memory=2.5 * TAKE.memory, threads=2)) == 2
    assert slots(TAKE, Machine(cores=16, memory=100 * TAKE.memory, threads=2)) == 8
    with pytest.raises(ValueError, match="no machine has them"):
        simulate(TAKE, Machine(cores=16, memory=0.5 * TAKE.memory, threads=2), 4)


def test_the_next_free_place_takes_the_next_part() -> None:
    assert finished([3.0, 1.0, 1.0, 1.0], 2) == 3.0
    assert finished([1.0, 1.0, 3.0], 2) == 4.0


def test_two_threads_are_as_fast_as_measured() -> None:
    assert sped_up(1) == 1
    assert sped_up(2) == pytest.approx(1 + SECOND_THREAD)
    # What one thread does alone stays: 2 / (1 + second) = 1 + alone.
    alone = 2 / (1 + SECOND_THREAD) - 1
    assert sped_up(10**6) == pytest.approx(1 / alone, rel=1e-3)


def test_it_reckons_what_was_measured_of_the_part_that_its_constants_are_not_from() -> None:
    """Frames 4 to 8 of 18 cameras of 1352x1014 (17 trained on), segments of 4, two threads: 24.8 s, start included."""
    part = Take(cameras=17, width=1352, height=1014, minutes=8 / 30 / 60, segment=4)
    assert part_walls(part, MACHINE)[1] == pytest.approx(24.8, rel=0.05)
