"""Where a frame's time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


def _processor_seconds() -> float:
    """Of all threads of this process."""
    return time.process_time()


@dataclass
class Stopwatch:
    """Wall-clock seconds by stage, and processor seconds since it was made."""

    seconds: dict[str, float] = field(default_factory=dict)
    began: float = field(default_factory=_processor_seconds)

    def cpu_seconds(self) -> float:
        """Processor seconds of all threads since it was made."""
        return _processor_seconds() - self.began

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Adds the wall-clock seconds spent inside to the stage ``name``."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
