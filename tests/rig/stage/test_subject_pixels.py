"""What stands before a plate: pixels that differ from it for sure, and what is fainter beside them."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.rig.stage.plain import subject_pixels

SHAPE = (60, 80, 3)
MIDDLE = slice(22, 38), slice(32, 48)
"""Well within a square that differs, of which a mean over 3 x 3 pixels has the whole difference."""


def subject(levels: float, *, noise: float = 0.0, size: int = 20, beside: float = 0.0) -> np.ndarray:
    """The subject where a square in the middle differs by so many 8-bit levels, what is to its right by ``beside``."""
    plate = np.full(SHAPE, 0.5, np.float32)
    picture = plate + np.random.default_rng(0).normal(0, noise / 255, SHAPE).astype(np.float32)
    half = size // 2
    picture[30 - half : 30 + half, 40 - half : 40 + half] += levels / 255
    picture[30 - half : 30 + half, 40 + half : 60 + half] += beside / 255
    return subject_pixels(picture, plate)


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_subject_differs_by_twelve_levels(sign: int) -> None:
    assert subject(13.5 * sign)[MIDDLE].all()
    assert not subject(13.5 * sign)[:, :25].any()
    assert not subject(10.5 * sign).any()


def test_half_of_that_is_enough_beside_a_subject() -> None:
    assert subject(13.5, beside=7)[MIDDLE[0], 55:65].all()
    assert not subject(13.5, beside=5)[MIDDLE[0], 55:65].any()
    assert not subject(0, beside=7).any()


def test_a_noisy_camera_s_subject_differs_by_more() -> None:
    """By five times the noise, of which four levels are believed at most."""
    assert not subject(13.0, noise=4.0).any()
    assert subject(25.0, noise=4.0)[MIDDLE].mean() > 0.99
    # Noise of 6 levels: differences, the largest of three colours and means of nine pixels, scatter by 2 levels.
    assert subject(23.0, noise=6.0)[MIDDLE].mean() > 0.99


def test_a_speck_is_no_subject() -> None:
    """Less than two ten-thousandths of a picture: in one of 200 x 300 pixels, a dozen."""
    plate = np.full((200, 300, 3), 0.5, np.float32)
    for side, is_subject in ((1, False), (2, True)):
        picture = plate.copy()
        picture[100 : 100 + side, 150 : 150 + side] = 1
        assert subject_pixels(picture, plate).any() == is_subject, side
