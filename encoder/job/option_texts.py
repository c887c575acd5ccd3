"""Texts of options as the library's values."""

from __future__ import annotations

import math
import re

from decogs.formats.errors import UsageError

_DURATION = re.compile(r"([0-9.eE+-]+?)\s*(ms|s)?\s*(?:/\s*frame)?")


def seconds_per_frame(text: str) -> float:
    """Seconds of ``1.5s/frame``, ``500ms/frame`` or plain ``1.5``; raises UsageError for what is no time."""
    match = _DURATION.fullmatch(text.strip())
    try:
        seconds = float(match[1]) * (0.001 if match[2] == "ms" else 1) if match else math.nan
    except ValueError:
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0):
        raise UsageError(f"--time-budget {text}: not a duration; write 1.5s/frame or 500ms/frame")
    return seconds


def names(text: str) -> list[str]:
    """Names with commas between them."""
    return [word.strip() for word in text.split(",") if word.strip()]
