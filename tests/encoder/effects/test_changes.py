"""What changed between two pictures, and whether a pattern moved or only its light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import pytest

from decogs.encoder.analysis.changes import ChangeShares, change_maps, successive_changes


def shares(before: np.ndarray, now: np.ndarray, noise: float = 1.0) -> tuple[float, float, float]:
    found = ChangeShares.of([change_maps(before, now, noise)], np.stack([before, now]), noise)
    return float(found.changed[1]), float(found.restructured[1]), float(found.near[1])


def with_square(picture: np.ndarray, left: int) -> np.ndarray:
    """A pattern of its own, 30 pixels wide, laid over the picture."""
    moved = picture.copy()
    moved[40:70, left : left + 30] = picture[75:105, 100:130][::-1]
    return moved


def test_noise_is_no_change(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    """The limit is seven deviations of a difference of 3 x 3 means; what is allowed is one pixel in ten thousand."""
    changed, restructured, _ = shares(with_noise(texture, 1), with_noise(texture, 2))
    assert changed < 1e-4
    assert restructured == 0


def test_successive_changes_are_those_of_each_pair(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    pictures = np.stack([with_noise(with_square(texture, 40 + 4 * step), step) for step in range(4)])
    for found, (before, now) in zip(successive_changes(pictures, 1.0), pairwise(pictures), strict=True):
        expected = change_maps(before, now, 1.0)
        np.testing.assert_array_equal(found.changed, expected.changed)
        np.testing.assert_array_equal(found.restructured, expected.restructured)
        assert expected.restructured.any()


def test_stronger_noise_needs_to_be_known(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    before, now = with_noise(texture, 1, 6.0), with_noise(texture, 2, 6.0)
    assert shares(before, now, noise=1.0)[0] > 0.1
    assert shares(before, now, noise=6.0)[0] < 1e-4


def test_light_changes_without_restructuring(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    """A lamp that brightens one side by up to 30 %."""
    light = np.linspace(1.0, 1.3, texture.shape[1], dtype=np.float32)[None, :, None]
    changed, restructured, _ = shares(with_noise(texture, 1), with_noise(texture * light, 2))
    assert changed > 0.5
    assert restructured < 0.001


def test_what_moves_restructures(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    """4 pixels of motion change the pattern over most of the square: more than half of it, nothing far from it."""
    before, now = with_square(texture, 40), with_square(texture, 44)
    changed, restructured, near = shares(with_noise(before, 1), with_noise(now, 2))
    square = 30 * 34 / texture[..., 0].size
    assert 0.5 * square < restructured < 2 * square
    assert near == changed


def test_a_light_elsewhere_is_not_near_what_moves(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    light = np.ones(texture.shape, np.float32)
    light[:, 120:] = 1.2
    changed, _, near = shares(
        with_square(texture, 20), np.clip(with_square(texture, 24) * light, 0, 255).astype(np.uint8)
    )
    lit = 40 / 160
    assert changed - near > 0.8 * lit


def test_the_first_frame_is_not_told(texture: np.ndarray) -> None:
    found = ChangeShares.of([change_maps(texture, texture, 1.0)], np.stack([texture, texture]), 1.0)
    assert np.isnan([found.changed[0], found.restructured[0], found.near[0]]).all()
    assert (found.changed[1], found.restructured[1], found.near[1]) == (0, 0, 0)


@pytest.mark.parametrize(("begins", "expected"), [(0, range(1, 9)), (4, range(5, 9)), (9, ())])
def test_light_that_no_two_frames_tell_is_found_over_several(
    texture: np.ndarray, with_noise: Callable[..., np.ndarray], begins: int, expected: Sequence[int]
) -> None:
    """1.5 % a frame on most of the picture, beside a square that moves; ``begins``: the last frame without."""
    pictures = []
    for frame in range(9):
        light = np.ones(texture.shape, np.float32)
        light[:, 40:] += 0.015 * max(0, frame - begins)
        lit = np.clip(with_square(texture, 2 + frame) * light, 0, 255)
        pictures.append(with_noise(lit, frame))
    maps = [change_maps(before, now, 1.0) for before, now in pairwise(pictures)]
    found = ChangeShares.of(maps, np.stack(pictures), 1.0)
    alone = found.changed - found.near
    assert np.nanmax(alone) < 0.02, "from one frame to the next it is hardly seen"
    slow = found.slow_changed - found.slow_near
    assert np.flatnonzero(slow > 0.1).tolist() == list(expected)
