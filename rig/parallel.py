"""Work on all views side by side, in the views' order, and ahead of time; results do not depend on threads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from typing import Protocol, TypeVar

import cv2

from decogs.formats.system.threads import processor_count

R = TypeVar("R")


class Each(Protocol):
    """``map`` over the views; the iterator gives results in their order and raises what the work raises."""

    def __call__(self, work: Callable[..., R], /, *views: Iterable[object]) -> Iterator[R]: ...


@contextmanager
def side_by_side(threads: int) -> Iterator[Each]:
    """A ``map`` on ``threads`` threads, 0 for one per processor.

    OpenCV's own threads are off meanwhile: they would only get in the way, and its flow depends on how many there are.
    """
    own_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with ThreadPoolExecutor(threads or processor_count()) as pool:
            yield pool.map
    finally:
        cv2.setNumThreads(own_threads)


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
