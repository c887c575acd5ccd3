"""The order in which training takes the views: at random, each once before any comes again."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def view_order(count: int, random: np.random.Generator) -> Iterator[int]:
    """Endless numbers below ``count``; a round is drawn when its first view is asked for."""
    while True:
        yield from reversed(random.permutation(count).tolist())
