"""Noise is told from what moves and from light, whatever of the picture they cover."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from decogs.encoder.change.masks import MaskMemory
from decogs.encoder.settings.frame import MaskSettings
from decogs.rig.pictures.noise import frame_noise, picture_noise

RNG = np.random.default_rng(5)
SIZE = (96, 128)


def texture(finest: int = 2) -> np.ndarray:
    """(H, W, 3) levels from 30 to 220, of details from ``finest`` pixels on."""
    total = np.zeros((*SIZE, 3), np.float32)
    for size in (2, 4, 8, 16, 40):
        if size >= finest:
            small = RNG.normal(0, 1, (SIZE[0] // size + 2, SIZE[1] // size + 2, 3)).astype(np.float32)
            total += cv2.resize(small, SIZE[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(120 + 20 * total, 30, 220)


def recorded(picture: np.ndarray, deviation: float) -> np.ndarray:
    noisy = np.clip(np.rint(picture + RNG.normal(0, deviation, picture.shape)), 0, 255)
    return np.ascontiguousarray(noisy.transpose(2, 0, 1), np.float32) / np.float32(255)


ROWS = np.arange(SIZE[0])[:, None, None]
CHANGES = {
    "a wave as fine as the rows": lambda p: p * (1 + 0.5 * np.sin(ROWS + 2)),
    "a faint wave": lambda p: p * (1 + 0.15 * np.sin(ROWS + 2)),
    "a wide wave": lambda p: p * (1 + 0.5 * np.sin(ROWS / 8 + 2)),
    "dimmed to a third": lambda p: p * 0.35,
    "inverted": lambda p: 255 - p,
    "a pan": lambda p: np.roll(p, 3, axis=1),
}


@pytest.mark.parametrize("deviation", [1.2, 3.0])
@pytest.mark.parametrize("name", CHANGES)
def test_a_change_of_most_of_the_picture_is_no_noise(name: str, deviation: float) -> None:
    scene = texture()
    before, now = recorded(scene, deviation), recorded(CHANGES[name](scene), deviation)
    settings = MaskSettings(threshold=10.0, radius_fraction=0.0)
    memory = MaskMemory.begin([before])
    plain = memory.pixel_changes([now], settings)[0].raw.mean()
    aware = MaskSettings(threshold=10.0, radius_fraction=0.0, noise_multiple=6.0)
    assert plain > 0.5
    assert memory.pixel_changes([now], aware)[0].raw.mean() == plain


@pytest.mark.parametrize("name", [name for name in CHANGES if name != "a pan"])
def test_noise_is_measured_through_light_that_changes(name: str) -> None:
    """Never below what there is by more than its quietest tiles are, nor half as much above."""
    scene, deviation = texture(), 1.5
    found = picture_noise(recorded(scene, deviation), recorded(CHANGES[name](scene), deviation))
    assert 0.8 * deviation < found < 1.6 * deviation


@pytest.mark.parametrize("deviation", [1.2, 4.0])
def test_noise_alone_is_exact(deviation: float) -> None:
    """To 8 %: the sample, and the tails that are cut off."""
    scene = texture(finest=4)
    now, before = recorded(scene, deviation), recorded(scene, deviation)
    truth = math.sqrt(deviation**2 + 1 / 12)
    assert picture_noise(before, now) == pytest.approx(truth, rel=0.08)
    assert frame_noise(now, before) == pytest.approx(math.sqrt(2) * truth, rel=0.08)


def test_a_noisy_camera_still_gets_its_threshold_beside_what_moves() -> None:
    scene, deviation = texture(), 5.0
    moved = scene.copy()
    moved[20:60, 30:100] = scene[20:60, 20:90]
    found = frame_noise(recorded(moved, deviation), recorded(scene, deviation))
    assert found == pytest.approx(math.sqrt(2) * deviation, rel=0.25)


def test_what_a_lens_did_not_record_tells_nothing_of_noise() -> None:
    """Straightened fisheyes are blank for the most part, and filled from what is beside."""
    scene, deviation = texture(3), 4.0
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    inside = ((row / SIZE[0] - 0.5) / 0.4) ** 2 + ((column / SIZE[1] - 0.5) / 0.3) ** 2 < 1
    pictures = [np.where(inside, recorded(scene, deviation), np.float32(0.5)) for _ in range(2)]
    assert picture_noise(*pictures, recorded=inside) == pytest.approx(deviation, rel=0.1)
    assert frame_noise(*pictures, recorded=inside) == pytest.approx(math.sqrt(2) * deviation, rel=0.1)


def test_pictures_that_tell_nothing_have_no_noise() -> None:
    for picture in (np.zeros((3, 8, 8), np.float32), np.ones((3, 40, 40), np.float32)):
        assert picture_noise(picture, picture) == frame_noise(picture, picture) == 0


@pytest.mark.parametrize("deviation", [0.8, 3.0])
def test_of_a_large_picture_a_part_tells_its_noise(deviation: float) -> None:
    """Values far apart and a row in six: to 1 %, and a hundred thousand values are .2 % off."""
    scene = np.tile(texture(8), (10, 10, 1))
    before, now = recorded(scene, deviation), recorded(np.roll(scene, 3, axis=1), deviation)
    now[:, 96:] = recorded(scene[96:], deviation)
    part = frame_noise(now, before)
    assert part == pytest.approx(frame_noise(now, before, samples=10**9), rel=0.01)
    assert part == pytest.approx(deviation * math.sqrt(2), rel=0.1)


@pytest.mark.parametrize(("too_few", "told"), [(0, (4**2 * 9 + 3**2) / 10), (1, (4**2 + 3**2) / 2)])
def test_a_row_in_two_tells_the_noise_where_half_the_values_of_these_suffice(too_few: int, told: float) -> None:
    """Rows have a noise of 3 and 4 in turn, and neighbours of the other. To 5 %: the tails are cut off."""
    deviation = np.where(np.arange(240) % 2, 4, 3)[:, None] / 255
    before, now = (np.float32(0.5) + RNG.normal(0, deviation, (240, 320)).astype(np.float32) for _ in range(2))
    assert picture_noise(before, now, before.size // 4 + too_few) == pytest.approx(math.sqrt(told), rel=0.05)
