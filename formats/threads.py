"""How many threads to use."""

from __future__ import annotations

import os

from .errors import UsageError


def thread_count(threads: int) -> int:
    """Number of threads to use: ``threads``, or all processors this process may use when it is 0."""
    if threads < 0 or threads > 1024:
        raise UsageError(f"`threads` {threads}: give a number from 1 to 1024, or 0 for all processors")
    return threads or len(os.sched_getaffinity(0))
