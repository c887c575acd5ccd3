"""What is told of lamps: their frequency, phase and strength, in cells where they differ, and pictures without them."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.codec.packets.corrections import LAMP_STEP
from decogs.formats.cameras import Camera
from decogs.rig.check.lamps import Lamps, find_lamps, hides_lamps, without_lamps
from flickering import HEIGHT, WIDTH, lamp, recorded


def found(pictures: np.ndarray, rate: float = 30.0, first: int = 0) -> Lamps:
    lamps = find_lamps(pictures, range(first, first + len(pictures)), rate)
    assert lamps is not None
    assert lamps.is_sure
    return lamps


@pytest.mark.parametrize("readout", [0.016, -0.023])
@pytest.mark.parametrize("turns", [0.0, 0.3, -0.45])
def test_the_phase_is_that_at_the_rigs_first_frame(readout: float, turns: float) -> None:
    """To two degrees, in whatever frames it is seen."""
    pictures = recorded(lamp(100, 0.15, turns), 30, readout, frames=30)
    for first in (0, 10):
        lamps = found(pictures[first:], first=first)
        apart = (lamps.phase_at(0, 30) - turns + 0.5) % 1 - 0.5
        assert abs(apart) < 2 / 360
        assert lamps.phase_at(3, 30) - lamps.phase == pytest.approx(lamps.wave.hertz / 10)
        assert (lamps.wave.columns, lamps.wave.rows) == (1, 1)
        # Odds change by a little more than light, whose display's curve is a power.
        np.testing.assert_allclose(np.array(lamps.wave.sine) * LAMP_STEP, 0.15, atol=0.04)
        np.testing.assert_allclose(np.array(lamps.wave.cosine) * LAMP_STEP, 0, atol=0.01)


def test_mains_are_a_little_off() -> None:
    assert found(recorded(lamp(100.05, 0.15), 30, 0.016, frames=60)).wave.hertz == pytest.approx(100.05, abs=0.01)


def test_lamps_of_two_phases_are_told_by_cells() -> None:
    """The right half is a third of a turn behind, and half as strong."""
    pictures = recorded(lamp(100, 0.2), 30, 0.016, other=lamp(100, 0.1, -1 / 3))
    lamps = found(pictures)
    cosine, sine = (part.mean(axis=(0, 2)) for part in lamps.wave.maps[::-1])
    waves = sine + 1j * cosine
    assert lamps.wave.columns == len(waves) == 8
    # The cells' own mean is phase 0; the middle ones, of 8 pixels each, are of one half.
    between = waves[-1] / waves[0]
    assert abs(between) == pytest.approx(0.5, abs=0.1)
    assert np.angle(between) / (2 * np.pi) == pytest.approx(-1 / 3, abs=0.02)


@pytest.mark.parametrize("other", [None, lamp(100, 0.1, -1 / 3)], ids=["one lamp", "two"])
def test_pictures_without_them_are_those_of_their_mean_light(other) -> None:
    """To a level, where the noise's own is 1.2."""
    camera = Camera("a", WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
    bent = recorded(lamp(100, 0.2), 30, 0.016, other=other)
    steady = recorded(lambda time: np.ones_like(time), 30, 0.016)
    left = without_lamps(bent, range(20), 30, camera, found(bent)).astype(float) - steady
    before = bent.astype(float) - steady
    inner = np.s_[:, :, : WIDTH // 2 - 4] if other is not None else np.s_[:]
    assert np.abs(before[inner]).mean() > 6
    rows = np.median(left[inner], axis=2)
    assert np.abs(rows).mean() < 1.2


def test_lamps_that_are_switched_off_are_found_in_the_frames_before() -> None:
    """All light falls by two fifths then; pictures after it stay as they are."""
    camera = Camera("a", WIDTH, HEIGHT, 60.0, 60.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
    off = 10 / 30
    pictures = recorded(lambda time: np.where(time < off - 0.02, lamp(100, 0.15)(time), 0.6), 30, 0.016)
    lamps = found(pictures)
    assert lamps.seen == slice(0, 10)
    assert 1000 * lamps.wave.readout == pytest.approx(16, abs=1)
    steady = without_lamps(pictures, range(20), 30, camera, lamps)
    np.testing.assert_array_equal(steady[10:], pictures[10:])
    assert (steady[:9] != pictures[:9]).any(axis=(1, 2, 3)).all()


@pytest.mark.parametrize(
    ("rate", "steps"), [(30.0, {3: True, 1: False, 2: False, 4: False, 6: True}), (25.0, {5: True, 1: False, 2: False})]
)
def test_frames_in_which_bands_would_stand_still_are_not_taken(rate: float, steps: dict[int, bool]) -> None:
    """At 30 a second those of 100 Hz do so over every third; of 120 Hz always, so that these do not count."""
    for step, hides in steps.items():
        assert hides_lamps(step, rate) == hides
