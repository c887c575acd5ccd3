"""What single steps of keys and plates decide: exposure of a plate, cloth that has the screen's colour."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.rig.mattes.chroma_key import _screen, _Tones
from decogs.rig.mattes.clean_plate import before_plate

SHAPE = (60, 80)
SUBJECT = (slice(15, 45), slice(20, 50))


@pytest.mark.parametrize("exposure", [0.8, 1.0, 1.2])
def test_the_exposure_may_have_moved_since_the_clean_picture(exposure: float) -> None:
    plate = np.random.default_rng(1).uniform(0.2, 0.4, (*SHAPE, 1)).repeat(3, axis=2).astype(np.float32)
    picture = plate * np.float32(exposure)
    picture[SUBJECT] = (0.6, 0.05, 0.05)
    found = before_plate(picture, plate)
    assert found is not None
    inside = np.zeros(SHAPE, bool)
    inside[SUBJECT] = True
    assert found.alpha[inside].mean() > 0.97
    assert found.alpha[~inside].mean() < 0.03


@pytest.mark.parametrize(("light", "is_subject"), [(0.5, True), (1.0, False)])
def test_dark_cloth_amid_the_subject_is_no_shadow_on_the_plate(light: float, is_subject: bool) -> None:
    """A shadow would explain it; a hole shows the plate as it is."""
    random = np.random.default_rng(1)
    plate = random.uniform(0.2, 0.4, (*SHAPE, 1)).repeat(3, axis=2).astype(np.float32)
    picture, amid = plate.copy(), (slice(26, 34), slice(30, 38))
    picture[SUBJECT] = (0.6, 0.05, 0.05)
    picture[amid] = light * plate[amid]
    found = before_plate(picture, plate)
    assert found is not None
    inside = found.alpha[28:32, 32:36]  # outlines are between
    assert (inside.min() > 0.95) if is_subject else (inside.max() < 0.05)


@pytest.mark.parametrize(
    ("angle", "saturation", "luma", "is_gap"),
    [
        (0, 1, 1, True),
        (0, 1, 0.5, True),
        (0, 1, 1.15, False),
        (2.5, 1, 1, False),
        (0, 0.935, 1, False),
        (0, 1.065, 1, False),
    ],
)
def test_cloth_like_the_screen_is_told_from_a_gap_by_its_colour_and_light(
    angle: float, saturation: float, luma: float, is_gap: bool
) -> None:
    """A gap has the screen's colour and is no brighter; what is between is taken for the subject's."""
    tones = _Tones(*(np.full(SHAPE, value, np.float32) for value in (0, 1, 1)))
    tones.angle[SUBJECT] = 90
    amid = (slice(26, 34), slice(30, 38))
    tones.angle[amid], tones.saturation[amid], tones.luma[amid] = angle, saturation, luma
    shown, worn = _screen(tones)
    assert shown[amid].all() == is_gap
    assert worn[amid].all() == (not is_gap)


@pytest.mark.parametrize(("pattern", "is_gap"), [(0.0, True), (0.02, True), (0.15, False)])
def test_cloth_of_the_screens_colour_is_told_from_a_gap_by_its_pattern(pattern: float, is_gap: bool) -> None:
    """Amid the subject, of the screen's colour and brightness; only its pattern is another's."""
    angle, luma = np.zeros(SHAPE, np.float32), np.ones(SHAPE, np.float32)
    angle[SUBJECT] = 90
    amid = (slice(26, 34), slice(30, 38))
    angle[amid] = 0
    luma[amid] = np.exp(pattern * (-1.0) ** np.indices((8, 8)).sum(axis=0))
    shown, worn = _screen(_Tones(angle, np.ones(SHAPE, np.float32), luma))
    assert shown[amid].all() == is_gap
    assert worn[amid].all() == (not is_gap)
    assert shown[:10].all()


@pytest.mark.parametrize(("columns", "is_shown"), [(2, False), (3, True)])  # of 12 000 pixels; 2.4 are enough
def test_specks_of_the_screens_colour_are_no_screen(columns: int, is_shown: bool) -> None:
    """At the picture's edge, where a region is no gap amid the subject."""
    tones = _Tones(*(np.full((100, 120), value, np.float32) for value in (0, 1, 1)))
    tones.angle[:50] = 90
    tones.angle[0, :columns] = 0
    shown, screen_coloured = _screen(tones)
    assert shown[0, :columns].all() == is_shown
    assert shown[50:].all()
    assert not screen_coloured.any()


@pytest.mark.parametrize(("side", "is_gap"), [(4, True), (3, False)])
def test_a_gap_has_four_pixels_within_its_rim(side: int, is_gap: bool) -> None:
    tones = _Tones(*(np.full(SHAPE, value, np.float32) for value in (0, 1, 1)))
    tones.angle[SUBJECT] = 90
    amid = (slice(26, 26 + side), slice(30, 30 + side))
    tones.angle[amid] = 0
    shown, screen_coloured = _screen(tones)
    assert shown[amid].all() == is_gap
    assert screen_coloured[amid].all() == (not is_gap)
