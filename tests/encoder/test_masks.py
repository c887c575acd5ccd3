"""Difference masks on known pictures. Source of the rules: DecoGS (D > tau, then max-pool with radius r)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from decogs.encoder.change.flashes import is_missed
from decogs.encoder.change.masks import (
    FrameMask,
    MaskMemory,
    PixelChange,
    difference_mask,
    dilate,
    faint_light_mask,
    remove_specks,
)
from decogs.encoder.settings.frame import MaskSettings
from decogs.formats.errors import UsageError
from decogs.rig.pictures.noise import frame_noise

RNG = np.random.default_rng(7)


class MaskSteps:
    """The masks of a stream's frames, one after the other, as `decogs.encoder.frame` makes them.

    ``memory`` is that before the next frame; ``pictures`` are the first frame's.
    """

    def __init__(self, pictures: Sequence[np.ndarray], settings: MaskSettings) -> None:
        self.memory, self.settings = MaskMemory.begin(pictures), settings

    def masks(self, pictures: Sequence[np.ndarray]) -> list[FrameMask]:
        changes = self.memory.pixel_changes(pictures, self.settings)
        return self.memory.masks(pictures, changes, self.settings)

    def trained(self, pictures: Sequence[np.ndarray], masks: Sequence[FrameMask], *, moved: bool) -> None:
        self.memory = self.memory.trained(pictures, masks, moved=moved)

    def passed(self, pictures: Sequence[np.ndarray]) -> None:
        self.memory = self.memory.advance(pictures, [], self.settings)


@pytest.fixture(autouse=True)
def fresh_numbers() -> None:
    """Each test has its own, whichever ran before it in its process: one in many draws makes a speck out of noise."""
    global RNG
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
    assert MaskSettings(radius_fraction=0.0).radius(1352) == 0


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
    kept = frame_masks([now], [before], MaskSettings(radius_fraction=0.0))[0].raw
    assert kept.sum() == 4
    cleaned = frame_masks([now], [before], MaskSettings(radius_fraction=0.0, speck_area=2))[0].raw
    np.testing.assert_array_equal(np.argwhere(cleaned), [[20, 20], [21, 21], [22, 22]])
    assert not remove_specks(kept, 4).any()


def test_a_change_too_slow_for_the_threshold_adds_up_until_it_is_seen() -> None:
    settings = MaskSettings(threshold=10.0, radius_fraction=0.0)
    for since_trained, expected in ((False, [0, 0, 0, 0]), (True, [0, 0, 1, 0])):
        chosen = replace(settings, since_trained=since_trained)
        memory, seen = MaskSteps([np.zeros((3, 8, 8), np.float32)], chosen), []
        for level in (4, 8, 12, 16):  # 8-bit levels of one pixel
            now = np.zeros((3, 8, 8), np.float32)
            now[:, 2, 5] = level / 255
            masks = memory.masks([now])
            seen.append(int(masks[0].raw.sum()))
            if masks[0].raw.any():
                memory.trained([now], masks, moved=True)
            memory.passed([now])
        assert seen == expected


def test_only_the_region_of_interest_takes_over_the_new_picture() -> None:
    before, now = np.zeros((3, 4, 4), np.float32), np.ones((3, 4, 4), np.float32)
    raw, dilated = np.zeros((4, 4), bool), np.zeros((4, 4), bool)
    dilated[1:3] = True
    memory = MaskSteps([before], MaskSettings(since_trained=True, radius_fraction=0))
    memory.trained([now], [FrameMask(raw, dilated)], moved=True)
    memory.passed([now])
    np.testing.assert_array_equal(memory.masks([now])[0].raw, ~dilated)


@pytest.mark.parametrize("levels", [3, 6])
@pytest.mark.parametrize("moved", [True, False])
def test_faint_light_counts_after_a_frame_in_which_only_light_changed(moved: bool, levels: float) -> None:
    before = np.full((3, 40, 40), 0.5, np.float32)
    lit = before.copy()
    lit[:, 10:26, 10:26] += levels / 255  # a sixth of the picture: it does not spread
    memory = MaskSteps([before], MaskSettings(threshold=10.0, radius_fraction=0.0, light_threshold=4.0))
    first = memory.masks([lit])
    assert not first[0].dilated.any(), "nothing is known of the light yet"
    memory.trained([lit], first, moved=moved)
    expected = np.zeros((40, 40), bool)
    expected[10:26, 10:26] = not moved
    mask = memory.masks([lit])[0]
    differs = mask.dilated != expected
    differs[9:27, 9:27] &= False  # the mean reaches 2 levels a pixel beyond the border, or inside it
    assert not differs.any()
    assert mask.dilated[12:24, 12:24].all() != moved
    assert not mask.raw.any(), "too faint for a flash, or a sign that a camera has not frozen"


@pytest.mark.parametrize(("columns", "counts"), [(70, False), (140, True)])
def test_light_that_reached_next_to_nothing_is_not_looked_for_more_closely(columns: int, counts: bool) -> None:
    """A pendulum at rest: its shading alone changes, and video coding adds to it (_MIN_LIGHT_ONLY_FRACTION)."""
    before = np.full((3, 140, 140), 0.5, np.float32)
    shaded, lit = before.copy(), before.copy()
    shaded[:, :7, :columns] += 3 / 255  # a fortieth of the picture, or a twentieth
    lit[:, 70:98, 70:98] += 3 / 255
    memory = MaskSteps([before], MaskSettings(threshold=10.0, radius_fraction=0.0, light_threshold=4.0))
    memory.trained([shaded], memory.masks([shaded]), moved=False)
    assert memory.masks([lit])[0].dilated.any() == counts


@pytest.mark.parametrize(("share", "levels"), [(0.15, 6), (0.6, 6), (1.0, 3)])
def test_light_that_falls_slowly_over_much_of_the_picture_counts_while_something_moves(
    share: float, levels: float
) -> None:
    before = RNG.normal(0.5, 1.5 / 255, (3, 120, 160)).astype(np.float32)
    now = RNG.normal(0.5, 1.5 / 255, (3, 120, 160)).astype(np.float32)
    now[:, :, : round(share * 160)] -= levels / 255
    now[:, 40:70, 100:130] += 0.3
    settings = MaskSettings(
        threshold=10.0, radius_fraction=0.018, speck_area=8, since_trained=True, light_threshold=4.0
    )
    memory = MaskSteps([before], settings)
    memory.trained([before], memory.masks([before]), moved=True)
    mask = memory.masks([now])[0]
    lit = mask.dilated[:, : round(share * 160) - 8]
    assert lit.all() if share > 0.2 else not lit.any()
    assert mask.raw[40:70, 100:130].all()
    assert mask.raw.mean() < 0.06, "the moving thing alone is a change that a flash or a frozen camera is told by"


def test_the_mean_that_tells_faint_light_is_blind_to_noise() -> None:
    deviation, faint = 6 / 255, 6 / 255
    before = RNG.normal(0.5, deviation, (3, 120, 160)).astype(np.float32)
    now = RNG.normal(0.5, deviation, (3, 120, 160)).astype(np.float32)
    # Noise of the mean over 49 pixels of a difference: 6 * sqrt(2) / 7 = 1.2 levels; 6 levels are five times that. At
    # the border the mean takes pixels twice.
    assert not faint_light_mask(now, before, 6.0)[3:-3, 3:-3].any()
    assert difference_mask(now, before, 6.0).mean() > 0.5
    now[:, 30:60, 40:80] += 2 * faint
    assert faint_light_mask(now, before, 6.0)[33:57, 43:77].all()


@pytest.mark.parametrize("deviation", [0.7, 2.0, 6.0])
def test_noise_is_measured_beside_what_moves(deviation: float) -> None:
    before = RNG.normal(128, deviation, (3, 120, 160))
    now = RNG.normal(128, deviation, (3, 120, 160))
    now[:, 20:60, 30:90] += 60  # an eighth of the picture changes
    pictures = [np.round(p).astype(np.float32) / 255 for p in (now, before)]
    # The difference of two frames, each rounded to whole levels; 8 % for the tails that are cut off and the sample.
    expected = np.sqrt(2 * (deviation**2 + 1 / 12))
    assert frame_noise(pictures[0], pictures[1]) == pytest.approx(expected, rel=0.08)
    assert frame_noise(pictures[0], pictures[0]) == 0


def test_a_noisy_camera_gets_a_threshold_of_its_own() -> None:
    quiet, noisy = (RNG.normal(128, d, (2, 3, 60, 80)).astype(np.float32) / 255 for d in (1.0, 8.0))
    now, before = [quiet[0], noisy[0]], [quiet[1], noisy[1]]
    shares = [m.raw.mean() for m in frame_masks(now, before, MaskSettings(threshold=10.0, radius_fraction=0))]
    assert shares[0] < 0.001
    assert shares[1] > 0.5
    aware = MaskSettings(threshold=10.0, radius_fraction=0, noise_multiple=5.0)
    assert all(m.raw.mean() < 0.001 for m in frame_masks(now, before, aware))


def test_rough_pictures_of_something_else_are_no_noise() -> None:
    before, now = RNG.uniform(0, 1, (2, 3, 60, 80)).astype(np.float32)
    (change,) = MaskMemory.begin([before]).pixel_changes([now], MaskSettings(noise_multiple=5.0))
    assert change.noise == 0
    assert change.raw.mean() > 0.9


def test_a_change_of_most_pixels_that_no_mask_has_is_taken_whole() -> None:
    """Half of the pixels, clearly, against what they were trained on and against what is shown; no lost view."""
    before = np.tile(np.linspace(0.1, 0.6, 8, dtype=np.float32), (3, 8, 1))
    now = before.copy()
    settings = MaskSettings(threshold=200.0)
    memory = MaskMemory.begin([before, before, before])
    for rows, shown, found in ((8, before, True), (4, before, False), (8, now, False)):
        now[:] = before
        now[:, :rows] += 0.3
        black = np.zeros((3, 8, 8), np.float32)
        changes = memory.pixel_changes([now, now, black], settings)
        assert not any(change.raw.any() for change in changes)
        assert is_missed(memory, [now, now, black], partial(list, [shown] * 3), changes) == found
        assert [bool(mask.dilated.all()) for mask in memory.full_masks(changes)] == [True, True, False]


@pytest.mark.parametrize(("changed", "found"), [(1, False), (2, True)])
def test_it_is_one_of_most_views(changed: int, found: bool) -> None:
    before = np.full((3, 8, 8), 0.4, np.float32)
    memory, now = MaskMemory.begin([before] * 3), [before + 0.3] * changed + [before] * (3 - changed)
    changes = memory.pixel_changes(now, MaskSettings(threshold=200.0))
    assert is_missed(memory, now, lambda: [before] * 3, changes) == found


FLAT = np.full((3, 8, 8), 0.5, np.float32)
NOWHERE = np.zeros((8, 8), bool)


def test_a_lost_picture_is_no_reference() -> None:
    lost, seen = (FrameMask(NOWHERE, NOWHERE, lost=why) for why in ("black", ""))
    pictures = [FLAT - 0.5, FLAT + 0.1]
    memory = MaskMemory.begin([FLAT, FLAT]).advance(pictures, [lost, seen], MaskSettings())
    assert memory.references[0] is FLAT
    assert memory.references[1] is pictures[1]


def test_a_picture_is_frozen_that_repeats_the_one_before_and_not_the_first() -> None:
    shown = [RNG.uniform(0, 1, (3, 8, 8)).astype(np.float32) for _ in range(3)]
    memory = MaskMemory.begin([shown[0]] * 3).advance([shown[1]] * 3, [], MaskSettings())
    changes = memory.pixel_changes([shown[1], shown[2], shown[2]], MaskSettings())
    assert [bool(change.lost) for change in changes] == [True, False, False]
    assert not any(change.lost for change in memory.pixel_changes([shown[0], shown[2], shown[2]], MaskSettings()))


def test_light_alone_is_remembered_for_one_frame() -> None:
    mask = FrameMask(NOWHERE, NOWHERE, faint_light=0.5)
    memory, told = MaskMemory.begin([FLAT]), []
    for moved in (False, True, False):
        memory = memory.trained([FLAT], [mask], moved=moved)
        told.append(memory.light_only)
    assert told == [True, False, True]


def test_a_light_that_steps_did_not_follow_is_remembered() -> None:
    memory, mask = MaskMemory.begin([FLAT]), FrameMask(NOWHERE, NOWHERE)
    told = []
    for relit in (False, True, False):
        memory = memory.trained([FLAT], [mask], moved=True, relit=relit)
        told.append(memory.relit)
    assert told == [False, True, True]


@pytest.mark.parametrize("compared", [True, False])
def test_what_training_missed_is_compared_with_what_is_shown(compared: bool) -> None:
    """As far as it ever changed, and by more than the first frame's error; fine texture is no part of the scene."""
    changed, shown = NOWHERE.copy(), FLAT.copy()
    changed[:, :4] = True
    shown[:, :2] += 0.3
    shown[:, 5:] += np.where(np.indices((3, 8)).sum(0) % 2, np.float32(0.05), np.float32(-0.05))
    memory = MaskMemory.begin([FLAT], [FLAT + np.float32(0.02)])
    memory = memory.trained([FLAT], [FrameMask(changed, changed)], moved=True)
    nothing = [FrameMask(NOWHERE, NOWHERE)]
    (reference,) = memory.trained([FLAT], nothing, moved=True, rendered=[shown] if compared else None).references
    expected = FLAT.copy()
    if compared:
        expected[:, :3, :4] = shown[:, :3, :4]  # a window reaches one row further
    np.testing.assert_array_equal(reference, expected)


def test_faint_light_is_told_from_the_noise_of_a_windows_mean() -> None:
    """A seventh of a pixel's, of 14 levels: three levels everywhere are light, one is not."""
    memory, settings = MaskMemory.begin([FLAT]), MaskSettings(radius_fraction=0.0, light_threshold=4.0)
    for levels, counts in ((3, True), (1, False)):
        (mask,) = memory.masks([FLAT + np.float32(levels / 255)], [PixelChange(NOWHERE, 14.0)], settings)
        assert mask.dilated.all() == mask.dilated.any() == counts


def frame_masks(current: list[np.ndarray], references: list[np.ndarray], settings: MaskSettings) -> list[FrameMask]:
    """Masks of a stream's second frame."""
    return MaskSteps(references, settings).masks(current)


def test_unfit_input_is_refused() -> None:
    picture = np.zeros((3, 4, 4), np.float32)
    with pytest.raises(ValueError, match=r"two \(3, H, W\)"):
        difference_mask(picture, picture[:, :3], 25.0)
    with pytest.raises(ValueError, match=r"shorter|longer"):
        frame_masks([picture], [], MaskSettings())
    for bad in ({"threshold": -1.0}, {"radius_fraction": float("nan")}, {"speck_area": -1}, {"noise_multiple": -1}):
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
