"""What all of an encode will take: from its first frames, or from figures of another one's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from .reports import FrameReport

FRAMES_KNOWN = 3
"""Of an encode, that tell what all of it will take."""
EIGHT_OF_TEN = 1.28
"""Standard deviations of a normal distribution."""
_SETTLING_FRAMES, _SETTLING = 20.0, 0.165
_SETTLING_SPREAD = 0.09
"""Later frames get cheaper, since what moves has been trained before: in five takes of 180 to 300 frames they had on
average .48 to .84 of the bytes of the first two (.64), up to frame 20 .81 to .97 (.88)."""


@dataclass(frozen=True)
class Factor:
    """How many times another figure: ``mean``, and the standard deviation of its logarithm (``spread``)."""

    mean: float
    spread: float


_KNOWN, _BEGUN = Factor(1.0, 0.0), Factor(1.0, 0.12)
"""Of what is done, and of what has begun."""


@dataclass(frozen=True)
class Range:
    """Where eight of ten rigs were."""

    low: float
    high: float


def whole_of(first: Sequence[FrameReport], frames: int) -> tuple[Range, Range]:
    """Bytes and processor seconds of a whole encode of so many frames, the ``first`` of which are known."""
    key, later = first[0], first[1:]
    count = len(later)
    return (
        total_of(key.bytes, _KNOWN, sum(each.bytes for each in later) / count, _BEGUN, frames),
        total_of(key.cpu_seconds, _KNOWN, sum(each.cpu_seconds for each in later) / count, _BEGUN, frames),
    )


def total_of(key: float, of_key: Factor, frame: float, of_frame: Factor, frames: int) -> Range:
    """Of a keyframe and all later frames; errors of the two have nothing to do with each other."""
    later = (frames - 1) * frame * settled(frames)
    strayed = math.hypot(of_frame.spread, _SETTLING_SPREAD * math.log1p(frames / _SETTLING_FRAMES))
    total = key + later
    spread = math.hypot(key * of_key.spread, later * strayed) / total if total else 0.0
    return Range(total * math.exp(-EIGHT_OF_TEN * spread), total * math.exp(EIGHT_OF_TEN * spread))


def settled(frames: int) -> float:
    """What later frames of so long a take have on average, in the first ones' figures."""
    return math.exp(-_SETTLING * math.log1p(frames / _SETTLING_FRAMES))
