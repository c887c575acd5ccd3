"""Types of the functions that libraries call while they work."""

from __future__ import annotations

from collections.abc import Callable

OnProgress = Callable[[int, int], None]
"""Called with the units done and the units in all; 0 in all while that is unknown."""

OnWarning = Callable[[str], None]
"""Called with one line that the user should read."""
