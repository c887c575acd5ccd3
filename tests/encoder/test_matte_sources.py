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
