"""What came and what went, told from what moved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import cv2
import numpy as np
import pytest

from decogs.encoder.analysis.arrivals import Arrivals, camera_arrivals
from decogs.encoder.analysis.changes import change_maps
from decogs.encoder.analysis.emergence import IMBALANCE


@pytest.fixture
def seen(with_noise: Callable[..., np.ndarray]) -> Callable[[Sequence[int | None]], Arrivals]:
    """A bright, speckled disc whose centre goes along these columns (None: not there), before a plain wall."""
    random = np.random.default_rng(5)
    speckles = cv2.resize(random.normal(0, 40, (30, 40, 3)).astype(np.float32), (160, 120))
    shade = np.linspace(70, 100, 160, dtype=np.float32)[None, :, None]

    def picture(column: int | None, seed: int) -> np.ndarray:
        wall = np.broadcast_to(shade, (120, 160, 3)).copy()
        if column is not None:
            disc = np.zeros((120, 160), np.uint8)
            cv2.circle(disc, (column, 60), 14, 1, -1)
            wall[disc == 1] = (180 + np.roll(speckles, column, axis=1))[disc == 1]
        return with_noise(wall, seed)

    def look(columns: Sequence[int | None]) -> Arrivals:
        pictures = np.stack([picture(column, seed) for seed, column in enumerate(columns)])
        return camera_arrivals(pictures, [change_maps(a, b, 1.2) for a, b in pairwise(pictures)], 1.2)

    return look


def beyond(values: np.ndarray) -> list[int]:
    return np.flatnonzero(np.nan_to_num(values) >= IMBALANCE).tolist()


def test_what_moves_balances(seen: Callable[..., Arrivals]) -> None:
    arrivals = seen([40, 40, 40, 50, 60, 70, 80, 90, 90, 90])
    assert (beyond(arrivals.arrived), beyond(arrivals.left)) == ([], [])


def test_what_comes_to_be_there_has_arrived(seen: Callable[..., Arrivals]) -> None:
    arrivals = seen([None, None, None, 60, 60, 60])
    assert (beyond(arrivals.arrived), beyond(arrivals.left)) == ([3], [])


def test_what_goes_out_of_the_picture_has_left(seen: Callable[..., Arrivals]) -> None:
    arrivals = seen([100, 100, 100, 115, 130, 145, 160, 175, 175, 175])
    assert beyond(arrivals.arrived) == []
    assert beyond(arrivals.left) == [3, 4, 5, 6, 7]


def test_where_nothing_happens_nothing_came(seen: Callable[..., Arrivals]) -> None:
    arrivals = seen([40, 40, 40, 40])
    np.testing.assert_array_equal(arrivals.arrived, [np.nan, 0, 0, 0])
    np.testing.assert_array_equal(arrivals.left, [np.nan, 0, 0, 0])


def test_what_still_moves_at_the_start_is_not_told(seen: Callable[..., Arrivals]) -> None:
    """It may have come from where it is in the first two steps: to and fro in place, and out."""
    assert np.isnan(seen([40, 48, 40, 48, 44]).arrived).all()


@pytest.fixture
def busy(with_noise: Callable[..., np.ndarray]) -> Callable[[Sequence[Sequence[tuple[int, int]]]], Arrivals]:
    """Speckled discs of radius 12 at these (column, row), one list per frame, before a wall of soft waves."""
    random = np.random.default_rng(6)
    speckles = cv2.resize(random.normal(0, 40, (30, 60, 3)).astype(np.float32), (240, 120))
    wall = 85 + 12 * np.sin(np.arange(240) / 9)[None, :, None] + np.zeros((120, 240, 3))

    def picture(discs: Sequence[tuple[int, int]], seed: int) -> np.ndarray:
        values = wall.astype(np.float32).copy()
        for column, row in discs:
            disc = np.zeros((120, 240), np.uint8)
            cv2.circle(disc, (column, row), 12, 1, -1)
            values[disc == 1] = (185 + np.roll(speckles, column, axis=1))[disc == 1]
        return with_noise(values, seed)

    def look(frames: Sequence[Sequence[tuple[int, int]]]) -> Arrivals:
        pictures = np.stack([picture(discs, seed) for seed, discs in enumerate(frames)])
        return camera_arrivals(pictures, [change_maps(a, b, 1.2) for a, b in pairwise(pictures)], 1.2)

    return look


WALK = [(20 + 9 * frame, 60) for frame in range(20)]
"""From one end of the picture to the other, in every frame."""


def test_what_rises_while_a_figure_walks_has_arrived(busy: Callable[..., Arrivals]) -> None:
    """In frames 4 to 6, where the figure comes by later on: first and last picture alone do not tell."""
    rising = [[], [], [], [], [(150, 80)], [(150, 70)], *[[(150, 62)]] * 14]
    arrivals = busy([[walker, *riser] for walker, riser in zip(WALK, rising, strict=True)])
    assert (beyond(arrivals.arrived), beyond(arrivals.left)) == ([4, 5, 6], [])


def test_what_leaves_while_a_drape_swings_has_left(busy: Callable[..., Arrivals]) -> None:
    drape = [(120 + round(8 * np.sin(frame)), 100) for frame in range(20)]
    cart = [*[[(60, 40)]] * 6, [(48, 40)], [(34, 40)], [(18, 40)], [(2, 40)], *[[]] * 10]
    arrivals = busy([[hanging, *leaving] for hanging, leaving in zip(drape, cart, strict=True)])
    assert beyond(arrivals.arrived) == []
    left = beyond(arrivals.left)
    assert left[0] == 6
    assert left[-1] in (10, 11)


def test_figures_that_walk_past_each_other_are_no_arrival(busy: Callable[..., Arrivals]) -> None:
    arrivals = busy([[there, (back[0], 84)] for there, back in zip(WALK, WALK[::-1], strict=True)])
    assert (beyond(arrivals.arrived), beyond(arrivals.left)) == ([], [])


def test_a_figure_that_stops_and_goes_on_is_no_arrival(busy: Callable[..., Arrivals]) -> None:
    columns = [30, 30, 40, 50, 60, 70, 70, 70, 70, 80, 90, 100, 110, 110, 110]
    arrivals = busy([[(column, 60)] for column in columns])
    assert (beyond(arrivals.arrived), beyond(arrivals.left)) == ([], [])
