"""What `decogs-encode --log` wrote."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from decogs.formats.errors import UsageError


def log_events(log: Path) -> Iterator[dict[str, Any]]:
    """Its events, one after the other. Raises UsageError for another file."""
    try:
        with log.open(encoding="utf-8") as file:
            for line in file:
                event = json.loads(line)
                if not isinstance(event, dict) or not isinstance(event.get("event"), str):
                    raise ValueError
                yield event
    except OSError as error:
        raise UsageError(f"`log` {log}: {error.strerror}; name a file that decogs-encode --log wrote") from error
    except ValueError as error:
        raise no_log(log) from error


def no_log(log: Path) -> UsageError:
    """What is wrong with a file of other contents."""
    return UsageError(f"`log` {log}: is no log of decogs-encode --log")


def recorded_of(log: Path) -> dict[int, dict[str, str]]:
    """Digests of the pictures of the rig's frames, by camera; a frame that was written again counts as it was last."""
    found = {}
    for event in log_events(log):
        if event["event"] == "frame":
            frame, recorded = event.get("frame"), event.get("recorded")
            if not isinstance(frame, int) or not isinstance(recorded, dict):
                raise no_log(log)
            found[frame] = recorded
    return found
