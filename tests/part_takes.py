"""The take that tests of parts encode, whole and in parts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

MOMENTS = (0, 1, 3, 1, 3, 0, 3)
SEGMENT = 2
FRAMES = len(MOMENTS)

Make = Callable[..., Path]
