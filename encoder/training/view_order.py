"""Order of the views in training: random, each once per round."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def view_order(count: int, random: np.random.Generator) -> Iterator[int]:
    """Endless numbers below ``count``; each round is a new permutation."""
    while True:
        yield from reversed(random.permutation(count).tolist())
