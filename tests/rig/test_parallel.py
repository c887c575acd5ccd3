"""Work side by side and ahead of time gives what it gives one after the other."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from decogs.rig.parallel import ahead, side_by_side


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_views_order(threads: int) -> None:
    with side_by_side(threads) as each:
        assert list(each(lambda a, b: 10 * a + b, range(9), range(9))) == [11 * n for n in range(9)]


def test_the_next_item_is_made_while_one_is_worked_on_and_no_more() -> None:
    made: list[int] = []
    second = threading.Event()

    def items() -> Iterator[int]:
        for n in range(4):
            made.append(n)
            if n == 1:
                second.set()
            yield n

    coming = ahead(items())
    assert next(coming) == 0
    assert second.wait(10)
    assert made == [0, 1]
    assert list(coming) == [1, 2, 3]
    assert list(ahead([])) == []


def test_what_fails_ahead_fails_when_its_turn_comes() -> None:
    def items() -> Iterator[int]:
        yield 1
        raise OSError("no second one")

    coming = ahead(items())
    assert next(coming) == 1
    with pytest.raises(OSError, match="no second one"):
        next(coming)


def test_who_stops_early_leaves_no_thread_behind() -> None:
    """Its thread is not waited for (see below), so it ends soon after."""
    before = set(threading.enumerate())
    coming = ahead(iter(range(10)))
    next(coming)
    (made,) = set(threading.enumerate()) - before
    coming.close()
    made.join(10)
    assert not made.is_alive()


def test_closing_joins_no_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """The garbage collector closes what was left half way, also where a join would wait for its own lock."""
    coming = ahead(range(3))
    next(coming)

    def joined(*_: object) -> None:
        raise AssertionError("joins a thread")

    monkeypatch.setattr(threading.Thread, "join", joined)
    coming.close()  # type: ignore[attr-defined]
