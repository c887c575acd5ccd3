"""What changed between two pictures, and whether a pattern moved or only its light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from decogs.encoder.analysis.changes import change_maps


def shares(before: np.ndarray, now: np.ndarray, noise: float = 1.0) -> tuple[float, float, float]:
    """Of the picture: changed, restructured, and changed near what is restructured."""
    maps = change_maps(before, now, noise)
    near = maps.changed & maps.around(now.shape[1])
    return float(maps.changed.mean()), float(maps.restructured.mean()), float(near.mean())


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
