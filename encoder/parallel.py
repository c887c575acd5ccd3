"""Work on all views side by side, in the views' order, and ahead of time; results do not depend on threads."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from itertools import islice
from typing import Any, Protocol, TypeVar

import cv2

from decogs.formats.threads import processor_count

R = TypeVar("R")


class Each(Protocol):
    """``map`` over the views; the iterator gives results in their order and raises what the work raises."""

    def __call__(self, work: Callable[..., R], /, *views: Iterable[object]) -> Iterator[R]: ...


@contextmanager
def side_by_side(threads: int) -> Iterator[Each]:
    """A ``map`` on ``threads`` threads, 0 for one per processor; all of its work is done at the end.

    OpenCV's own threads are off meanwhile: they would only get in the way, and its flow depends on how many there are.
    """
    own_threads, pool = cv2.getNumThreads(), _POOLS.of(threads or processor_count())
    begun: list[Future[Any]] = []

    def each(work: Callable[..., R], /, *views: Iterable[object]) -> Iterator[R]:
        futures = [pool.submit(work, *view) for view in zip(*views, strict=False)]
        begun.extend(futures)
        return (future.result() for future in futures)

    cv2.setNumThreads(1)
    try:
        yield each
    except BaseException:
        for future in begun:
            future.cancel()
        raise
    finally:
        wait(begun)
        cv2.setNumThreads(own_threads)


class _Pools(threading.local):
    """Threads are kept, for each thread that asks: what works side by side may itself ask for others."""

    def __init__(self) -> None:
        self._made: dict[tuple[int, int], ThreadPoolExecutor] = {}

    def of(self, threads: int) -> ThreadPoolExecutor:
        key = os.getpid(), threads  # a forked child has none of its parent's
        if key not in self._made:
            self._made[key] = ThreadPoolExecutor(threads)
        return self._made[key]


_POOLS = _Pools()


def ahead(items: Iterable[R]) -> Iterator[R]:
    """The items in their order, each made on a thread of its own while the one before it is worked on."""
    coming = iter(items)
    maker = ThreadPoolExecutor(1)
    try:
        after = maker.submit(list, islice(coming, 1))
        while now := after.result():
            after = maker.submit(list, islice(coming, 1))
            yield now[0]
    finally:
        # Without waiting: the garbage collector may close this while it holds the lock that joining a thread takes.
        maker.shutdown(wait=False, cancel_futures=True)
