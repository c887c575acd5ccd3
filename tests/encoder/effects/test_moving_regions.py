"""Where a frame moves, and that light alone is no motion; in doubt motion."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from decogs.encoder import PRESETS
from decogs.encoder.analysis.enabled import enabled_effects
from decogs.encoder.analysis.moving_regions import moving_regions
from decogs.encoder.change.masks import FrameMask, difference_mask, dilate


def planes(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(picture.transpose(2, 0, 1), np.float32) / np.float32(255)


def masked(now: np.ndarray, before: np.ndarray) -> FrameMask:
    raw = difference_mask(now, before, 10.0)
    return FrameMask(raw, dilate(raw, 6))


Moving = list[np.ndarray] | None


@pytest.fixture
def moving(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> Callable[..., Moving]:
    """What moves in views that go from the texture to each of these pictures."""

    def look(*pictures: np.ndarray) -> Moving:
        before = [planes(with_noise(texture, 2 * k)) for k in range(len(pictures))]
        now = [planes(with_noise(picture, 2 * k + 1)) for k, picture in enumerate(pictures)]
        return moving_regions(now, before, [masked(*pair) for pair in zip(now, before, strict=True)])

    return look


@pytest.fixture
def moved(texture: np.ndarray) -> np.ndarray:
    picture = texture.copy()
    picture[40:80, 60:100] = texture[40:80, 55:95]
    return picture


@pytest.fixture
def lit(texture: np.ndarray) -> np.ndarray:
    return texture * np.linspace(1.0, 1.3, texture.shape[1])[None, :, None]


def test_nothing_moves_in_a_frame_like_the_last(moving: Callable[..., Moving], texture: np.ndarray) -> None:
    assert moving(texture, texture) is None


def test_light_alone_is_no_motion(moving: Callable[..., Moving], lit: np.ndarray) -> None:
    assert moving(lit, lit) is None


def test_motion_in_one_view_is_motion(moving: Callable[..., Moving], moved: np.ndarray, lit: np.ndarray) -> None:
    regions = moving(lit, moved, lit)
    assert regions is not None
    assert [bool(region.any()) for region in regions] == [False, True, False]


def test_what_moves_is_told_from_what_is_lit(moving: Callable[..., Moving], moved: np.ndarray) -> None:
    """A patch moves on the left, light falls on the right, in one picture."""
    moved[20:100, 120:] = np.minimum(moved[20:100, 120:] * 1.2, 255)
    regions = moving(moved, moved)
    assert regions is not None
    for region in regions:
        assert region[45:75, 65:95].mean() > 0.9
        assert region[30:90, 130:].mean() < 0.05


def test_motion_enables_all_that_an_encode_has_and_light_one_effect(
    moved: np.ndarray, lit: np.ndarray, texture: np.ndarray
) -> None:
    """Light trains no geometry, whatever the preset has."""
    settings = replace(PRESETS["standard"], effects=("motion", "appearance_change", "emergence"))
    before = planes(texture)
    for picture, effects in ((moved, settings.effects), (lit, ("appearance_change",))):
        now = planes(np.clip(picture, 0, 255).astype(np.uint8))
        found = enabled_effects(settings, moving_regions([now], [before], [masked(now, before)]))
        assert found.effects == effects
        assert (found.settings == settings) == (found.moving is not None) == ("motion" in effects)
        assert (found.settings.frame.rates.means > 0) == ("motion" in effects)


def test_a_speck_is_in_doubt(moving: Callable[..., Moving], texture: np.ndarray) -> None:
    """It only brightens, but a hundred pixels are too few to tell."""
    speck = texture.copy()
    speck[50:60, 50:60] = np.minimum(speck[50:60, 50:60] + 30, 255)
    assert moving(speck) is not None


def test_large_pictures_are_looked_at_small(texture: np.ndarray, moved: np.ndarray) -> None:
    """Five by five of them: the same answer. Budget 15 ms a view; loose (shared machines), the best of five counts."""
    before, now = (planes(np.tile(picture, (5, 5, 1))) for picture in (texture, moved))
    mask = masked(now, before)
    seconds = []
    for _ in range(5):
        began = time.perf_counter()
        assert moving_regions([now], [before], [mask]) is not None
        seconds.append(time.perf_counter() - began)
    assert min(seconds) < 0.15


def test_views_must_be_the_same(texture: np.ndarray) -> None:
    picture = planes(texture)
    with pytest.raises(ValueError, match="zip"):
        moving_regions([picture], [picture], [])
