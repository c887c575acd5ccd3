"""Pictures that do not show their frame: what counts as blank, and as a repeat."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.rig.pictures.dropouts import BLACK, BLANK, blankness, repeats

RANDOM = np.random.default_rng(4)


def of_one_colour(level: float, noise: float = 3.0) -> np.ndarray:
    """(3, H, W), with noise of so many levels."""
    levels = level + RANDOM.normal(0, noise, (3, 48, 64))
    return np.clip(levels / 255, 0, 1).astype(np.float32)


@pytest.mark.parametrize(("level", "told"), [(0, BLACK), (2, BLACK), (90, BLANK), (255, BLANK)])
def test_one_colour_up_to_a_dark_sensors_noise_shows_nothing(level: float, told: str) -> None:
    assert blankness(of_one_colour(level, noise=2.0)) == told


def test_some_broken_pixels_show_nothing_either() -> None:
    picture = of_one_colour(0, noise=1.0)
    picture[:, 7, 20:35] = 1.0  # 15 of 3072, half a per cent
    assert blankness(picture) == BLACK
    picture[:, 10:20] = 1.0
    assert blankness(picture) == "", "a fifth of the picture is something"


def test_something_in_one_channel_is_something() -> None:
    picture = of_one_colour(90, noise=1.0)
    picture[2, :24] += 0.1
    assert blankness(picture) == ""


def test_a_large_picture_is_sampled() -> None:
    assert blankness(np.tile(of_one_colour(90, noise=2.0), (1, 20, 20))) == BLANK


def test_a_repeat_is_the_same_to_the_bit_everywhere() -> None:
    before = of_one_colour(90)
    assert repeats(before.copy(), before)
    for row in (0, 17):  # one that is looked at first, and one that is not
        now = before.copy()
        now[1, row, 5] += 1 / 255
        assert not repeats(now, before)
