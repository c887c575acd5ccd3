"""Gaussians of random values, for tests of files."""

from __future__ import annotations

import numpy as np

from decogs.formats.splats import Splats


def random_splats(count: int, coefficients: int, seed: int = 0) -> Splats:
    """So many, with so many SH coefficients: positions about 1, sizes of e^-8 to e, opacities of .007 to .993."""
    random = np.random.default_rng(seed)
    values = (
        random.normal(size=(count, 3)),
        random.uniform(-8, 1, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(-5, 5, count),
        random.uniform(-0.9, 0.9, (count, coefficients, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))
