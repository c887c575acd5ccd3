"""A subject over one flat colour: which it is, and what is exchanged at its outline."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.rig.pictures.compositing import background_for, over


def flat(*colour: float) -> np.ndarray:
    return np.broadcast_to(np.float32(colour)[:, None, None], (3, 10, 12)).copy()


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_the_background_is_as_far_from_the_subject_as_a_colour_can_be(channel: int) -> None:
    picture = flat(*(0.9 if k == channel else 0.0 for k in range(3)))
    chosen = background_for([picture], [np.ones((10, 12), np.float32)])
    assert np.abs(np.array(chosen) - picture[:, 0, 0]).max() == 1.0


def test_only_what_is_opaque_is_the_subjects_colour() -> None:
    """White cloth, and an outline in which a black backdrop shows: black is free to be the background."""
    picture, alpha = flat(1, 1, 1), np.ones((10, 12), np.float32)
    picture[:, :, 6:], alpha[:, 6:] = 0.1, 0.1
    assert background_for([picture], [alpha]) == (0.0, 0.0, 0.0)


def test_every_picture_counts() -> None:
    """One subject is red, green and blue, the other white: all but black is worn."""
    one = flat(1, 0, 0)
    one[:, :, 4:8], one[:, :, 8:] = np.float32([0, 1, 0])[:, None, None], np.float32([0, 0, 1])[:, None, None]
    opaque = np.ones((10, 12), np.float32)
    others = [flat(1, 1, 1), flat(0, 1, 1), flat(1, 0, 1), flat(1, 1, 0)]
    assert background_for([one, *others], [opaque] * 5) == (0.0, 0.0, 0.0)
    assert background_for([one, *others[1:], flat(0, 0, 0)], [opaque] * 5) == (1.0, 1.0, 1.0)


def test_without_an_opaque_pixel_it_is_black() -> None:
    assert background_for([flat(1, 1, 1)], [np.zeros((10, 12), np.float32)]) == (0.0, 0.0, 0.0)


def test_a_known_plate_is_exchanged_for_the_background_and_an_unknown_one_stays_in_the_mix() -> None:
    subject, plate, chosen = flat(0, 0.9, 0), flat(0.2, 0.2, 0.2), (1.0, 0.0, 1.0)
    half = np.full((10, 12), 0.5, np.float32)
    mixed = half * subject + (1 - half) * plate
    np.testing.assert_allclose(over(mixed, half, chosen, plate)[:, 0, 0], [0.5, 0.45, 0.5], atol=1e-6)  # float32
    np.testing.assert_allclose(over(mixed, half, chosen)[:, 0, 0], [0.55, 0.275, 0.55], atol=1e-6)
    np.testing.assert_array_equal(over(flat(1, 1, 1), half, (1.0, 1.0, 1.0), plate), flat(1, 1, 1))  # not above white
