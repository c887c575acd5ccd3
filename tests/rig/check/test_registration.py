"""A camera that shakes, told from things that move before one that does not."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from decogs.rig.check.registration import SHAKE_LIMIT_PIXELS, camera_path


def turned(picture: np.ndarray, degrees: float, across: float, down: float) -> np.ndarray:
    height, width = picture.shape[:2]
    how = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), degrees, 1.0)
    how[:, 2] += across, down
    return cv2.warpAffine(picture, how, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


def test_a_still_camera_does_not_shake(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    path = camera_path(np.stack([with_noise(texture, seed) for seed in range(4)]))
    assert path.displacement.max() < SHAKE_LIMIT_PIXELS / 2
    assert not path.shakes


def test_shake_is_measured(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    """A shift of (0.9, -0.6) pixels, to a twentieth; the size told is what 70 % of the corners move by at least."""
    path = camera_path(np.stack([with_noise(texture, 1), with_noise(turned(texture, 0.0, 0.9, -0.6), 2)]))
    assert path.displacement[1] == pytest.approx(np.hypot(0.9, 0.6), abs=0.1)
    centre = np.array([79.5, 59.5, 1.0])
    np.testing.assert_allclose(path.transforms[1] @ centre - centre[:2], [0.9, -0.6], atol=0.05)
    assert path.shakes


def test_light_does_not_shake(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> None:
    light = np.linspace(0.8, 1.2, texture.shape[1])[None, :, None]
    path = camera_path(np.stack([with_noise(texture, 1), with_noise(texture * light, 2)]))
    assert not path.shakes


@pytest.mark.parametrize("rows_of_a_stripe", [5, 8, 12])
def test_stripes_of_lamps_do_not_shake(
    texture: np.ndarray, with_noise: Callable[..., np.ndarray], rows_of_a_stripe: int
) -> None:
    """An LED wall, too fast for the mains' alias: its stripes stand elsewhere in each picture."""
    phase = 2 * np.pi * np.arange(texture.shape[0]) / rows_of_a_stripe
    shown = [with_noise(texture * (1 + 0.3 * np.sin(phase + 2 * k))[:, None, None], k) for k in range(4)]
    assert not camera_path(np.stack(shown)).shakes


def test_a_thing_before_most_of_the_picture_is_no_shake(
    texture: np.ndarray, with_noise: Callable[..., np.ndarray]
) -> None:
    """Six pixels of ten move by 2; the rest stays."""
    now = texture.copy()
    now[:, 64:] = turned(texture, 0.0, 2.0, 0.0)[:, 64:]
    assert not camera_path(np.stack([with_noise(texture, 1), with_noise(now, 2)])).shakes


def test_a_picture_without_corners_tells_nothing() -> None:
    path = camera_path(np.full((3, 48, 64, 3), 90, np.uint8))
    assert np.isnan(path.displacement).all()
    assert not path.shakes
