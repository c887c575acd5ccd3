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

from decogs.formats.system.threads import processor_count

R = TypeVar("R")


class Each(Protocol):
    """``map`` over the views; the iterator gives results in their order and raises what the work raises."""

    def __call__(self, work: Callable[..., R], /, *views: Iterable[object]) -> Iterator[R]: ...


@contextmanager
def side_by_side(threads: int) -> Iterator[Each]:
    """A ``map`` on ``threads`` threads, 0 for one per processor; all of its work is done at the end.

    OpenCV's own threads are off meanwhile: they would only get in the way, and its flow depends on how many there are.
    """
    pool = _POOLS.of(threads or processor_count())
    begun: list[Future[Any]] = []

    def each(work: Callable[..., R], /, *views: Iterable[object]) -> Iterator[R]:
        futures = [pool.submit(work, *view) for view in zip(*views, strict=False)]
        begun.extend(futures)
        return (future.result() for future in futures)

    with _OPENCVS_THREADS.off():
        try:
            yield each
        except BaseException:
            for future in begun:
                future.cancel()
            raise
        finally:
            wait(begun)


class _OpenCvsThreads:
    """OpenCV's own, which are off as long as anybody works side by side."""

    def __init__(self) -> None:
        self._lock, self._working, self._own = threading.Lock(), 0, 0

    @contextmanager
    def off(self) -> Iterator[None]:
        with self._lock:
            self._working += 1
            if self._working == 1:
                self._own = cv2.getNumThreads()
                cv2.setNumThreads(1)
        try:
            yield
        finally:
            with self._lock:
                self._working -= 1
                if not self._working:
                    cv2.setNumThreads(self._own)


_OPENCVS_THREADS = _OpenCvsThreads()


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


class Ahead(Iterator[R]):
    """The items in their order, each made on a thread of its own while the one before it is worked on."""

    def __init__(self, items: Iterable[R]) -> None:
        self._coming, self._maker = iter(items), ThreadPoolExecutor(1, thread_name_prefix="ahead")
        self._after = self._next()

    def __next__(self) -> R:
        now = self._after.result()
        if not now:
            self.close()
            raise StopIteration
        self._after = self._next()
        return now[0]

    def peek(self) -> list[R]:
        """The next item, waited for; none after the last."""
        return self._after.result()

    def close(self) -> None:
        """Makes no more."""
        # Without waiting: the garbage collector may close this while it holds the lock that joining a thread takes.
        self._maker.shutdown(wait=False, cancel_futures=True)

    __del__ = close

    def _next(self) -> Future[list[R]]:
        return self._maker.submit(list, islice(self._coming, 1))
