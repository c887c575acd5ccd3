"""Values that go on into gaps."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.rig.mattes.filling import push_pull, shrunk_and_filled


def one_colour(shape: tuple[int, int]) -> np.ndarray:
    return np.broadcast_to(np.float32([0.2, 0.5, 0.7]), (*shape, 3)).copy()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 5), (64, 48)])
def test_a_single_value_fills_everything(shape: tuple[int, int]) -> None:
    values, weights = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    values[-1, -1], weights[-1, -1] = (0.2, 0.5, 0.7), 1
    np.testing.assert_allclose(push_pull(values, weights), one_colour(shape), atol=1e-6)  # float32


def test_what_has_a_value_keeps_it_and_a_gap_gets_what_is_around_it() -> None:
    values, weights = np.zeros((32, 32, 1), np.float32), np.ones((32, 32), np.float32)
    values[:, 16:] = 1
    weights[8:24, 8:24] = 0
    values[8:24, 8:24] = 9  # behind the gap, whatever it is
    filled = push_pull(values, weights)[..., 0]
    np.testing.assert_array_equal(filled[weights > 0], values[..., 0][weights > 0])
    inside = filled[8:24, 8:24]
    assert inside.min() >= 0
    assert inside.max() <= 1
    assert inside[:, 0].mean() < 0.25
    assert inside[:, -1].mean() > 0.75


def test_without_any_value_it_is_black() -> None:
    assert not push_pull(one_colour((6, 6)), np.zeros((6, 6), np.float32)).any()


def test_a_shrunk_picture_goes_on_where_it_has_no_weight() -> None:
    picture, weights = one_colour((40, 60)), np.ones((40, 60), np.float32)
    picture[:, 30:], weights[:, 30:] = 0, 0
    np.testing.assert_allclose(shrunk_and_filled(picture, weights, (15, 10)), one_colour((10, 15)), atol=1e-6)
