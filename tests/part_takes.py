"""The take that tests of parts encode, whole and in parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from decogs.codec.packets.corrections import Correction

MOMENTS = (0, 1, 3, 1, 3, 0, 3)
SEGMENT = 2
FRAMES = len(MOMENTS)

Make = Callable[..., Path]


def drifting(name: str, frame: int) -> Correction:
    """One camera's exposure, frame by frame."""
    return Correction(exposure=100 * frame) if name == "cam01" else Correction()
