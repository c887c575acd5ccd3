"""What one frame brings: motion, only light, or nothing; in doubt motion."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

from decogs.encoder.analysis.frame_effects import FrameEffects, frame_effects
from decogs.encoder.change.masks import FrameMask, difference_mask, dilate

LIGHT_ONLY = FrameEffects(motion=False, appearance_change=True)
MOTION_ONLY = FrameEffects(motion=True, appearance_change=False)


def planes(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32) / np.float32(255)


def masked(now: np.ndarray, before: np.ndarray) -> FrameMask:
    raw = difference_mask(now, before, 10.0)
    return FrameMask(raw, dilate(raw, 6))


@pytest.fixture
def told(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> Callable[..., FrameEffects]:
    """The effects of views that go from the texture to each of these pictures."""

    def tell(*pictures: np.ndarray) -> FrameEffects:
        before = [planes(with_noise(texture, 2 * k)) for k in range(len(pictures))]
        now = [planes(with_noise(picture, 2 * k + 1)) for k, picture in enumerate(pictures)]
        return frame_effects(now, before, [masked(*pair) for pair in zip(now, before, strict=True)])

    return tell


@pytest.fixture
def moved(texture: np.ndarray) -> np.ndarray:
    picture = texture.copy()
    picture[40:80, 60:100] = texture[40:80, 55:95]
    return picture


@pytest.fixture
def lit(texture: np.ndarray) -> np.ndarray:
    return texture * np.linspace(1.0, 1.3, texture.shape[1])[None, :, None]


def test_a_frame_like_the_last_brings_nothing(told: Callable[..., FrameEffects], texture: np.ndarray) -> None:
    assert told(texture, texture) == FrameEffects(motion=False, appearance_change=False)


def test_light_alone_is_no_motion(told: Callable[..., FrameEffects], lit: np.ndarray) -> None:
    effects = told(lit, lit)
    assert effects == LIGHT_ONLY
    assert not effects.emergence
    assert not effects.disappearance


def test_motion_may_bring_something_new(told: Callable[..., FrameEffects], moved: np.ndarray) -> None:
    effects = told(moved, moved)
    assert effects == MOTION_ONLY
    assert effects.emergence
    assert effects.disappearance


def test_motion_in_one_view_is_motion(told: Callable[..., FrameEffects], moved: np.ndarray, lit: np.ndarray) -> None:
    assert told(lit, moved, lit) == FrameEffects(motion=True, appearance_change=True)


def test_what_moves_is_told_from_what_is_lit(told: Callable[..., FrameEffects], moved: np.ndarray) -> None:
    """A patch moves on the left, light falls on the right, in one picture."""
    moved[20:100, 120:] = np.minimum(moved[20:100, 120:] * 1.2, 255)
    effects = told(moved, moved)
    assert effects.motion
    assert effects.appearance_change
    for moving in effects.moving:
        assert moving[45:75, 65:95].mean() > 0.9
        assert moving[30:90, 130:].mean() < 0.05


def test_a_speck_is_in_doubt(told: Callable[..., FrameEffects], texture: np.ndarray) -> None:
    """It only brightens, but a hundred pixels are too few to tell."""
    speck = texture.copy()
    speck[50:60, 50:60] = np.minimum(speck[50:60, 50:60] + 30, 255)
    assert told(speck).motion


def test_large_pictures_are_looked_at_small(texture: np.ndarray, moved: np.ndarray) -> None:
    """Five by five of them: the same answer. Budget 15 ms a view; loose (shared machines), the best of five counts."""
    before, now = (planes(np.tile(picture, (5, 5, 1))) for picture in (texture, moved))
    mask = masked(now, before)
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        assert frame_effects([now], [before], [mask]).motion
        seconds.append(time.perf_counter() - began)
    assert min(seconds) < 0.15


def test_views_must_be_the_same(texture: np.ndarray) -> None:
    picture = planes(texture)
    with pytest.raises(ValueError, match="zip"):
        frame_effects([picture], [picture], [])
