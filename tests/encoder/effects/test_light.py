"""A camera's gain is told from a change of the scene's light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from decogs.encoder.effects.light import (
    EXPOSURE_LIMIT,
    FRAME_LIMIT,
    WHITE_BALANCE_LIMIT,
    Light,
    camera_light,
    steady_light,
    without_drift,
)


def lit(picture: np.ndarray, gain: float | np.ndarray) -> np.ndarray:
    """The picture with its linear light (sRGB) times ``gain``."""
    coded = picture / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4) * gain
    linear = np.clip(linear, 0, 1)
    return np.rint(255 * np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055))


@pytest.fixture
def seen(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> Callable[..., Light]:
    """The light of cameras that see the texture first as it is, then under each one's gain."""

    def look(*gains: float | np.ndarray) -> Light:
        frames = [[with_noise(texture, 2 * k), with_noise(lit(texture, g), 2 * k + 1)] for k, g in enumerate(gains)]
        return steady_light([camera_light(np.stack(pictures)) for pictures in frames])

    return look


def test_a_gain_of_one_camera_is_its_own(seen: Callable[..., Light]) -> None:
    """The block medians hold it to a twentieth of itself."""
    light = seen(1.0, 1.12, 1.0, 1.0)
    assert light.gains[1, 1, 0] == pytest.approx(np.log(1.12), rel=0.05)
    assert light.exposure[1, 1] > EXPOSURE_LIMIT
    assert light.exposure[[0, 2, 3], 1].max() < EXPOSURE_LIMIT / 4
    assert light.white_balance.max() < WHITE_BALANCE_LIMIT / 4


def test_a_gain_of_red_is_white_balance(seen: Callable[..., Light]) -> None:
    light = seen(1.0, np.array([1.06, 1.0, 1.0]), 1.0)
    assert light.gains[1, 1, 1] == pytest.approx(np.log(1.06), rel=0.05)
    assert light.white_balance[1, 1] > WHITE_BALANCE_LIMIT
    assert light.exposure[1, 1] < EXPOSURE_LIMIT


def test_what_all_cameras_share_is_the_scenes(seen: Callable[..., Light]) -> None:
    light = seen(1.1, 1.1, 1.1, 1.1)
    assert light.exposure.max() < EXPOSURE_LIMIT / 4
    assert np.abs(light.gains).max() < FRAME_LIMIT


def test_a_lamp_on_half_of_the_picture_is_no_gain(seen: Callable[..., Light]) -> None:
    lamp = np.ones((1, 160, 1))
    lamp[:, 70:] = 1.4
    assert seen(lamp, 1.0, 1.0).exposure.max() < EXPOSURE_LIMIT / 4


def test_a_single_camera_has_nothing_to_be_compared_with(seen: Callable[..., Light]) -> None:
    alone = seen(1.12)
    assert not alone.compared
    assert alone.exposure[0, 1] > EXPOSURE_LIMIT


def test_drift_is_undone(texture: np.ndarray) -> None:
    """Curves through 16 points, rounding of both pictures: within two levels for nine pixels of ten."""
    pictures = np.stack([texture, lit(texture, 1.15).astype(np.uint8)])
    steady = without_drift(pictures, camera_light(pictures).curves)
    missed = np.abs(steady[1].astype(int) - texture)
    assert np.quantile(np.abs(pictures[1].astype(int) - texture), 0.1) > 4
    assert np.quantile(missed, 0.9) <= 2


def test_what_does_not_drift_is_left_alone(texture: np.ndarray) -> None:
    pictures = np.stack([texture, texture])
    light = steady_light([camera_light(pictures)])
    assert light.curves() == [None]
    assert without_drift(pictures, None) is pictures


def test_a_black_picture_tells_nothing() -> None:
    light = steady_light([camera_light(np.zeros((3, 48, 64, 3), np.uint8))] * 3)
    assert np.isnan(light.exposure).all()
    assert light.curves() == [None] * 3
