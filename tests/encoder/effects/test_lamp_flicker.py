"""Mains lamps over rolling shutters are found, with their frequency and each camera's readout, and nothing else is."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from decogs.encoder.analysis.effect import Evidence
from decogs.encoder.analysis.lamp_flicker import LampFlicker
from decogs.encoder.settings.encode import EncodeSettings
from decogs.rig.check.lamps import find_lamps
from flickering import HEIGHT, WIDTH, Pulse, lamp, recorded


def found(pictures: list[np.ndarray], rate: float | None) -> tuple[Evidence, Any, Any]:
    names = tuple(f"cam{index:02d}" for index in range(len(pictures)))
    frames = tuple(range(len(pictures[0])))
    lamps = tuple(find_lamps(own, frames, rate) for own in pictures)
    stats: Any = type("Stats", (), {"lamps": lamps, "names": names, "cameras": names, "frames": frames})()
    effect = LampFlicker()
    evidence = effect.evidence(stats)
    return evidence, effect.decide(stats, evidence), stats


@pytest.mark.parametrize(
    ("hertz", "rate"),
    [(100, 24), (100, 30), (100, 30_000 / 1001), (100, 60), (100, 120), (120, 25), (120, 50), (100.03, 30)],
)
@pytest.mark.parametrize("readout", [0.0158, -0.028])
def test_lamps_are_found_at_any_frame_rate_read_from_above_and_below(hertz: float, rate: float, readout: float) -> None:
    evidence, decision, _ = found([recorded(lamp(hertz, 0.15), rate, readout)], rate)
    assert decision.detected
    assert 1000 * readout == pytest.approx(evidence.details["readout_ms"][0, 0], abs=0.2)
    assert evidence.details["hertz"][0, 0] == round(hertz)
    # A display's curve changes the odds of its values by a little more or less than light.
    assert evidence.peak == pytest.approx(15, abs=4)
    mains = round(hertz / 2)
    assert re.match(rf"lamps at {2 * mains} Hz: cam00 reads its rows in \d+\.\d ms and sees", decision.cost)
    assert f"1/{2 * mains} or 1/{mains} s" in decision.cost


def test_only_cameras_that_show_bands_are_named() -> None:
    cameras = [recorded(lamp(100, 0.05), 30, 0.016, phase=0.003 * index, seed=index) for index in range(3)]
    cameras.insert(1, recorded(lamp(100, 0.0), 30, 0.016, seed=9))
    evidence, decision, _ = found(cameras, 30)
    assert decision.cameras == ("cam00", "cam02", "cam03")
    assert evidence.values[1, 0] == 0
    np.testing.assert_allclose(evidence.details["readout_ms"][[0, 2, 3], 0], 16, atol=0.3)
    built = LampFlicker().enabled(EncodeSettings(), decision)
    assert tuple(built.corrections.lamps) == tuple(built.corrections.lamp_phases) == decision.cameras
    assert LampFlicker().disabled(built) == EncodeSettings()
    assert "lamps" not in built.as_document().get("corrections", {}), "the header's cameras have them"


def test_five_frames_and_a_dark_picture_suffice() -> None:
    few = recorded(lamp(100, 0.15), 30, 0.016, frames=5)
    dark = recorded(lamp(100, 0.15), 30, 0.016, bright=0.05)
    over = recorded(lamp(100, 0.3), 30, 0.016, bright=1.3)
    for pictures in few, dark, over:
        evidence, decision, _ = found([pictures], 30)
        assert decision.detected
        assert evidence.details["readout_ms"][0, 0] == pytest.approx(16, abs=0.4)


def a_flash(time: np.ndarray) -> np.ndarray:
    return np.where((time > 0.3) & (time < 0.312), 1.8, 1.0)


def a_candle(time: np.ndarray) -> np.ndarray:
    return np.asarray(1 + 0.1 * np.sin(2 * np.pi * 7.3 * time) + 0.05 * np.sin(2 * np.pi * 11.1 * time + 1))


@pytest.mark.parametrize(
    "pulse",
    [lamp(100, 0.0), lamp(1000.0, 0.3), lamp(93.0, 0.2), a_flash, a_candle],
    ids=["steady", "LED wall", "no mains", "flash", "candle"],
)
@pytest.mark.parametrize("seed", range(3))
def test_other_light_is_no_lamp_s(pulse: Pulse, seed: int) -> None:
    _, decision, _ = found([recorded(pulse, 30, 0.016, seed=seed)], 30)
    assert not decision.detected
    assert decision.cost == "none"


def test_a_candle_or_a_flash_beside_them_hides_no_bands() -> None:
    for other in a_candle, a_flash:
        both = recorded(lambda time, other=other: lamp(100, 0.1)(time) * other(time), 30, 0.016)  # type: ignore[misc]
        evidence, decision, _ = found([both], 30)
        assert decision.detected
        assert evidence.details["readout_ms"][0, 0] == pytest.approx(16, abs=0.8)


def test_bands_that_stand_still_tell_nothing_in_time() -> None:
    """100 Hz at 25 frames a second; 120 Hz, which would wander there, is not seen."""
    _, decision, _ = found([recorded(lamp(100, 0.15), 25, 0.016)], 25)
    assert not decision.detected


@pytest.mark.parametrize(("rate", "frames"), [(None, 20), (30.0, 4)])
def test_without_a_rate_or_with_few_frames_nothing_can_be_told(rate: float | None, frames: int) -> None:
    evidence, decision, _ = found([recorded(lamp(100, 0.15), 30, 0.016, frames=frames)], rate)
    assert not np.isfinite(evidence.values).any()
    assert decision.confidence == 0
    assert decision.reason.startswith("undetermined: fewer than five frames")


def test_one_even_grey_picture_has_no_wave() -> None:
    evidence, decision, _ = found([np.full((8, HEIGHT, WIDTH, 3), 90, np.uint8)], 30)
    assert not decision.detected
    assert not np.isfinite(evidence.peak)
