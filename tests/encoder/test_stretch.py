"""The limit on how long and thin a trained Gaussian may become."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.encoder.backends.cpu.stretch import limit_stretch, stretches


def sizes(*rows: tuple[float, float, float]) -> np.ndarray:
    return np.log(np.array(rows, np.float32))


def test_the_stretch_is_largest_over_middle_whatever_the_order_of_axes() -> None:
    random = np.random.default_rng(3)
    rows = random.uniform(-5, 1, (200, 3)).astype(np.float32)
    ordered = np.sort(rows, axis=1)
    np.testing.assert_array_equal(stretches(rows), ordered[:, 2] - ordered[:, 1])


def test_a_needle_is_shortened_and_a_disc_is_not() -> None:
    now = sizes((8, 1, 1), (1, 1, 0.001), (0.5, 6, 1), (3, 1, 0.1))
    before = sizes((1, 1, 1), (1, 1, 1), (1, 1, 1), (1, 1, 1))
    limit_stretch(now, before, 4.0)
    # float32 logarithms of sizes up to 8: rounded by at most 1e-6
    np.testing.assert_allclose(np.exp(now), [(4, 1, 1), (1, 1, 0.001), (0.5, 4, 1), (3, 1, 0.1)], rtol=2e-6)


@pytest.mark.parametrize(("length", "middle", "limited"), [(10.0, 1.0, 8.0), (16.0, 2.0, 16.0), (6.0, 1.0, 6.0)])
def test_what_was_longer_before_grows_no_longer(length: float, middle: float, limited: float) -> None:
    """From 8 : 1 it may become 16 : 2 or 6 : 1, not 10 : 1."""
    now = sizes((length, middle, 0.5))
    limit_stretch(now, sizes((8.0, 1.0, 0.5)), 4.0)
    assert np.exp(now[0, 0]) == pytest.approx(limited, rel=2e-6)
