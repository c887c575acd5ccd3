"""Ranges of frames: as values, as the user of a command writes them, "A:B", and as messages name them."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ..errors import UsageError

_RANGE = re.compile(r"\s*([+-]?[0-9]{1,4000})?\s*:\s*([+-]?[0-9]{1,4000})?\s*", re.ASCII)


Frames = slice | range | None
"""Which frames: a slice by Python's rules, a range of their numbers, or None for all."""


def frame_slice(frames: Frames, parameter: str = "frames") -> slice:
    """The same as a slice; raises UsageError, which names the ``parameter``, for anything else."""
    asked = slice(None) if frames is None else frames
    ends = (asked.start, asked.stop, asked.step) if isinstance(asked, (slice, range)) else ("",)
    if not all(end is None or hasattr(end, "__index__") for end in ends):
        raise UsageError(f"`{parameter}` {frames!r}: give a slice or a range of whole numbers, such as slice(0, 10)")
    return slice(*ends)


def frame_range(text: str | None) -> slice | None:
    """A range of frames as the user writes it: "A:B", half-open as in Python, each end may be missing or negative.

    None, all of them, for an option that was not given. Raises UsageError for anything else.
    """
    if text is None:
        return None
    ends = _RANGE.fullmatch(text)
    if ends is None:
        raise UsageError(f"frames {text!r} are no range; write A:B, half-open as in Python, such as 0:10 or -5:")
    first, last = (int(end) if end else None for end in ends.groups())
    return slice(first, last)


def frames_text(numbers: Sequence[int], *, most: int | None = None) -> str:
    """ "frames 3 to 5, 9" for ascending numbers; of more than ``most`` rows the first ones, and how many there are."""
    rows: list[list[int]] = []
    for frame in numbers:
        if rows and frame == rows[-1][1] + 1:
            rows[-1][1] = frame
        else:
            rows.append([frame, frame])
    named = ", ".join(f"{first} to {last}" if last > first else str(first) for first, last in rows[:most])
    more = "" if most is None or len(rows) <= most else f" and {len(rows) - most} more"
    return f"frame{'s'[: len(numbers) > 1]} {named}{more}"
