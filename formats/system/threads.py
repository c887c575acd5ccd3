"""How many threads to use."""

from __future__ import annotations

import math
import os
from pathlib import Path, PurePosixPath

from ..errors import UsageError

_CGROUPS = Path("/sys/fs/cgroup")
_OWN_CGROUP = Path("/proc/self/cgroup")


def thread_count(threads: int) -> int:
    """Number of threads to use: ``threads``, or all processors this process may use when it is 0."""
    if not (hasattr(threads, "__index__") and 0 <= threads <= 1024):
        raise UsageError(f"`threads` {threads}: give a whole number from 1 to 1024, or 0 for all processors")
    return threads or processor_count()


def processor_count() -> int:
    """Processors that this process may use: by its affinity, and by a container's quota (cgroup v2, ``cpu.max``).

    More threads than the quota allows would only be stopped until the period is over. Part of a processor counts whole.
    """
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(processors, math.ceil(_quota(_CGROUPS, _OWN_CGROUP))))


def _quota(cgroups: Path, own: Path) -> float:
    """Processors that the group of this process and those around it may use; a large number where there is no limit."""
    try:
        lines = own.read_text().splitlines()
    except OSError:
        lines = []
    # A container may see its own group as the root, or not see the path that the host has for it.
    group = PurePosixPath(next((line[3:] for line in lines if line.startswith("0::/")), "/"))
    return min(_limit(cgroups / str(at).lstrip("/") / "cpu.max") for at in (group, *group.parents))


def _limit(file: Path) -> float:
    """Of one group: its line is ``QUOTA PERIOD`` in microseconds, or ``max PERIOD``."""
    try:
        quota, period = file.read_text().split()
        return int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return 1 << 20
