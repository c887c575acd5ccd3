"""Difference masks on known pictures. Source of the rules: DecoGS (D > tau, then max-pool with radius r)."""

from __future__ import annotations

import time

import numpy as np
import pytest

from decogs.encoder.masks import FrameMask, MaskSettings, difference_mask, dilate, frame_masks, without_specks
from decogs.formats.errors import UsageError

RNG = np.random.default_rng(7)


def levels(picture: np.ndarray) -> np.ndarray:
    """8-bit levels as a planar picture in 0..1, as the rig readers make it."""
    return picture.astype(np.float32) / np.float32(255)


def test_mask_equals_integer_arithmetic_for_every_pair_of_levels() -> None:
    now, before = np.meshgrid(np.arange(256), np.arange(256))
    zero = np.zeros_like(now)
    for threshold in (0, 1, 24, 25, 254):
        for channel in range(3):
            planes = [zero, zero, zero], [zero, zero, zero]
            planes[0][channel], planes[1][channel] = now, before
            mask = difference_mask(levels(np.stack(planes[0])), levels(np.stack(planes[1])), threshold)
            np.testing.assert_array_equal(mask, np.abs(now - before) > threshold)


def test_channels_are_not_added_up() -> None:
    before = np.zeros((3, 1, 1), np.float32)
    assert not difference_mask(before + np.float32(20 / 255), before, 25.0).any()


def test_dilate_grows_a_point_to_a_square_cut_at_the_border() -> None:
    mask = np.zeros((20, 30), bool)
    mask[4, 1] = mask[15, 20] = True
    expected = np.zeros_like(mask)
    expected[1:8, 0:5] = expected[12:19, 17:24] = True
    np.testing.assert_array_equal(dilate(mask, 3), expected)


@pytest.mark.parametrize("radius", [1, 4, 12, 100])
def test_dilate_equals_a_plain_max_pool(radius: int) -> None:
    mask = RNG.random((33, 41)) > 0.995
    expected = np.zeros_like(mask)
    for y, x in np.argwhere(mask):
        expected[max(0, y - radius) : y + radius + 1, max(0, x - radius) : x + radius + 1] = True
    np.testing.assert_array_equal(dilate(mask, radius), expected)


def test_radius_zero_gives_the_mask_itself_as_a_copy() -> None:
    mask = RNG.random((9, 9)) > 0.5
    same = dilate(mask, 0)
    np.testing.assert_array_equal(same, mask)
    assert not np.shares_memory(same, mask)


def test_radius_scales_with_the_width() -> None:
    assert MaskSettings().radius(1352) == 48  # the paper's
    assert MaskSettings().radius(352) == 12
    assert MaskSettings(radius_share=0.0).radius(1352) == 0


def test_frame_masks_of_a_moved_square() -> None:
    before, now = np.full((2, 3, 264, 352), 0.5, np.float32)
    before[:, 100:110, 200:210] = now[:, 100:110, 203:213] = 1.0
    still = before.copy()
    moved, unmoved = frame_masks([now, still], [before, still], MaskSettings())
    raw = np.zeros((264, 352), bool)
    raw[100:110, 200:203] = raw[100:110, 210:213] = True
    focus = np.zeros_like(raw)
    focus[88:122, 188:225] = True
    np.testing.assert_array_equal(moved.raw, raw)
    np.testing.assert_array_equal(moved.dilated, focus)
    assert isinstance(unmoved, FrameMask)
    assert not unmoved.raw.any()
    assert not unmoved.dilated.any()


def test_specks_are_kept_unless_asked_for() -> None:
    before = np.zeros((3, 40, 40), np.float32)
    now = before.copy()
    now[:, 3, 3] = now[:, 20, 20] = now[:, 21, 21] = now[:, 22, 22] = 1.0  # one pixel, and a diagonal of three
    kept = frame_masks([now], [before], MaskSettings(radius_share=0.0))[0].raw
    assert kept.sum() == 4
    cleaned = frame_masks([now], [before], MaskSettings(radius_share=0.0, speck_area=2))[0].raw
    np.testing.assert_array_equal(np.argwhere(cleaned), [[20, 20], [21, 21], [22, 22]])
    assert not without_specks(kept, 4).any()


def test_unfit_input_is_refused() -> None:
    picture = np.zeros((3, 4, 4), np.float32)
    with pytest.raises(ValueError, match=r"two \(3, H, W\)"):
        difference_mask(picture, picture[:, :3], 25.0)
    with pytest.raises(ValueError, match=r"shorter|longer"):
        frame_masks([picture], [], MaskSettings())
    for bad in ({"threshold": -1.0}, {"radius_share": float("nan")}, {"speck_area": -1}):
        with pytest.raises(UsageError, match=next(iter(bad))):
            MaskSettings(**bad)  # type: ignore[arg-type]


def test_masks_of_twelve_views_are_cheap() -> None:
    """Budget 15 ms for 12 views of 352x264; the bound is loose (shared machines), the best of ten runs counts."""
    now, before = (list(RNG.random((12, 3, 264, 352), np.float32)) for _ in range(2))
    best = min(_seconds(now, before) for _ in range(10))
    assert best < 0.06


def _seconds(now: list[np.ndarray], before: list[np.ndarray]) -> float:
    start = time.process_time()
    frame_masks(now, before, MaskSettings())
    return time.process_time() - start
