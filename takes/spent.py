"""What an encode has cost, from the log that it wrote."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from decogs.formats.errors import UsageError

from .encode_log import log_events, no_log


@dataclass(frozen=True)
class Spent:
    """``wall`` and ``cpu`` seconds of an encode, with all runs that it took; of these those of its first frame
    (``key_cpu``), and how many ``frames`` it trained."""

    wall: float
    cpu: float
    key_cpu: float
    frames: int

    @property
    def text(self) -> str:
        """A sentence for the page."""
        later = f", {(self.cpu - self.key_cpu) / (self.frames - 1):.2f} CPU-s each later one" if self.frames > 1 else ""
        return (
            f"Encoded in {self.wall:.0f} s with {self.cpu:.0f} seconds of processor time: {self.key_cpu:.0f} for the "
            f"first frame{later}."
        )


def read_spent(log: Path) -> Spent:
    """Of a file that `decogs-encode --log` wrote. Raises UsageError for another."""
    wall = elapsed = cpu = key_cpu = 0.0
    frames = 0
    try:
        for event in log_events(log):
            if event["event"] == "start":
                wall, elapsed = wall + elapsed, 0.0
            elapsed = max(elapsed, float(event.get("elapsed", 0.0)))
            if event["event"] == "frame" and not event["replayed"]:
                cpu += float(event["cpu_seconds"])
                key_cpu += float(event["cpu_seconds"]) if not frames else 0.0
                frames += 1
    except (ValueError, KeyError, TypeError) as error:
        raise no_log(log) from error
    if not frames:
        raise UsageError(f"`log` {log}: has no frame that was trained")
    return Spent(wall + elapsed, cpu, key_cpu, frames)
