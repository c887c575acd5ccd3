"""Lamps that flicker over rolling shutters are taken out before masks and training, and told in the stream."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.packets.corrections import LAMP_STEP, Correction, LampWave, lamps_of, phase_steps, with_lamps
from decogs.decoder.cameras.corrections import as_recorded
from decogs.decoder.cameras.lamps import lamp_light
from decogs.encoder.input.compensation import CorrectionMemory, Corrector
from decogs.encoder.input.compensation.agreement import SharedSurface
from decogs.encoder.input.compensation.lamps import LampView
from decogs.encoder.settings.effects import CorrectionSettings
from decogs.formats.cameras import Camera
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest, View

ONE = LampWave(100.0, 0.016, 1, 1, (614, 614, 614), (0, 0, 0))
TWO = LampWave(100.0, -0.02, 2, 2, (800, 600, 400) * 4, (0, 200, -100, 300, 0, 0, -300, 50, 0, 0, 0, 100))
FULL = round(1 / LAMP_STEP)


def a_camera(**lens: Any) -> Camera:
    return Camera("a", 120, 90, 100.0, 100.0, 60.0, 45.0, np.eye(4), **lens)


def some_picture(seed: int) -> np.ndarray:
    """(90, 120, 3), smooth, from 0.1 to 0.9."""
    noise = np.random.default_rng(seed).uniform(0, 1, (9, 12, 3)).astype(np.float32)
    return np.asarray(0.1 + 0.8 * cv2.resize(noise, (120, 90), interpolation=cv2.INTER_LINEAR), np.float32)


def planar(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image.transpose(2, 0, 1), np.float32)


def test_the_wave_is_that_of_the_specification() -> None:
    """SPEC section 6, "Lamps", written out for single points."""
    correction = Correction(lamp_phase=-9000, lamp_amplitude=5000, lamp=TWO)
    across, down = np.array([0.05, 0.4, 0.99]), np.array([0.9, 0.3, 0.5])
    light = lamp_light(correction, across, down)
    for point, (x, y) in enumerate(zip(across, down, strict=True)):
        w = 2 * np.pi * (-9000 / 65536 + TWO.hertz * TWO.readout * y)
        u, v = (min(max(2 * share - 0.5, 0), 1) for share in (x, y))
        for channel in range(3):
            strength = []
            for numbers in (TWO.sine, TWO.cosine):
                a, b, c, d = (numbers[3 * cell + channel] / 4096 for cell in range(4))
                strength.append((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d))
            wanted = 1 + 5000 / 4096 * (strength[0] * np.sin(w) + strength[1] * np.cos(w))
            assert light[point, channel] == pytest.approx(wanted, rel=1e-6)
    strong = replace(correction, lamp_amplitude=32_767)
    assert lamp_light(strong, np.array([0.5]), np.linspace(0, 1, 50)).min() == pytest.approx(1 / 8)


def test_a_recorded_picture_is_undone_and_made_again() -> None:
    camera, shown = a_camera(), some_picture(1)
    correction = Correction(exposure=100, falloff=900, lamp_phase=5000, lamp_amplitude=FULL, lamp=TWO)
    recorded = as_recorded(shown, correction, camera)
    assert np.abs(recorded - shown).mean() > 0.02
    np.testing.assert_allclose(as_recorded(recorded, correction, camera, undo=True), shown, atol=1e-5)
    none = replace(correction, lamp_amplitude=0)
    np.testing.assert_array_equal(
        as_recorded(shown, none, camera), as_recorded(shown, replace(none, lamp=None), camera)
    )


@pytest.mark.parametrize("wave", [ONE, TWO], ids=["one", "cells"])
@pytest.mark.parametrize(("turns", "strength"), [(0.1, 1.0), (-0.4, 0.3), (0.49, 1.5)])
def test_phase_and_strength_are_found_whatever_moves_or_dims(wave: LampWave, turns: float, strength: float) -> None:
    """To two degrees and two hundredths; a fifth of the picture shows something else, and all is a tenth brighter."""
    camera, shown = a_camera(), some_picture(2)
    truth = Correction(exposure=400, lamp_phase=phase_steps(turns), lamp_amplitude=round(strength * FULL), lamp=wave)
    recorded = as_recorded(shown, truth, camera)
    recorded = recorded + np.random.default_rng(0).normal(0, 1.2 / 255, recorded.shape)
    recorded[20:55, 20:70] = some_picture(9)[:35, :50]
    lamp = LampView(wave, View(camera, camera, None))
    found = lamp.find(planar(np.clip(recorded, 0, 1)), planar(shown))
    assert abs(found.lamp_phase - truth.lamp_phase) / 65536 * 360 < 2
    assert found.lamp_amplitude == pytest.approx(truth.lamp_amplitude, abs=0.02 * FULL)


def test_over_exposed_and_black_pixels_tell_nothing_and_white_stays() -> None:
    camera, shown = a_camera(), some_picture(3)
    lamp = LampView(ONE, View(camera, camera, None))
    white = np.ones((3, 90, 120), np.float32)
    assert lamp.find(white, planar(shown)) == Correction()
    assert lamp.find(planar(shown), 0 * white) == Correction()
    np.testing.assert_array_equal(lamp.undo(white, Correction(lamp_phase=3, lamp_amplitude=FULL)), white)
    # Bands that are clipped at their brightest.
    bright = np.clip(1.3 * shown, 0, 1)
    recorded = np.clip(as_recorded(bright, Correction(lamp_phase=8000, lamp_amplitude=FULL, lamp=ONE), camera), 0, 1)
    assert abs(lamp.find(planar(recorded), planar(bright)).lamp_phase - 8000) / 65536 * 360 < 3


def test_a_lamp_that_is_switched_off_has_no_strength() -> None:
    camera, shown = a_camera(), some_picture(4)
    lamp = LampView(ONE, View(camera, camera, None))
    dim = as_recorded(shown, Correction(exposure=-1500), camera)
    assert lamp.find(planar(dim), planar(shown)).lamp_amplitude < 0.03 * FULL


def test_rows_are_those_of_the_recorded_picture_through_a_lens() -> None:
    """What training sees through a lens is undone where it was recorded."""
    from decogs.decoder.cameras.lens import Undistortion

    camera = a_camera(distortion_model="opencv", distortion=(-0.25, 0.0, 0.0, 0.0))
    plan, shown = Undistortion(camera), some_picture(5)
    correction = Correction(lamp_phase=12_000, lamp_amplitude=FULL, lamp=TWO)
    recorded, valid = as_recorded(shown, correction, camera), plan.valid.astype(np.float32)
    view = View(camera, plan.pinhole, valid)
    left = LampView(TWO, view).undo(planar(plan.apply(recorded)), correction) - planar(plan.apply(shown))
    # Resampling is not linear in odds; at the border it mixes with nothing.
    inner = cv2.erode(valid, np.ones((7, 7))) > 0
    assert np.abs(left[:, inner]).max() < 0.004


def test_lamps_are_foretold_from_the_analysis_and_from_what_was_seen_last() -> None:
    views = [View(replace(a_camera(), name=name), replace(a_camera(), name=name), None) for name in "ab"]
    corrector = Corrector(views, CorrectionSettings(lamps={"b": ONE}, lamp_phases={"b": 0.25}))
    assert corrector.cameras.lamp_flicker == ("b",)
    told = corrector.foretold(3, 30.0, None)
    assert told == {"b": Correction(lamp_phase=phase_steps(0.25 + 100 * 3 / 30), lamp_amplitude=FULL)}
    nowhere = np.zeros((2, 0), np.int64)
    memory = CorrectionMemory(SharedSurface(nowhere, nowhere, nowhere > 0))
    seen = memory.begin({"b": Correction(lamp_phase=1000, lamp_amplitude=3000)}, 10)
    assert corrector.foretold(11, 30.0, seen)["b"] == Correction(
        lamp_phase=phase_steps(1000 / 65536 + 100 / 30), lamp_amplitude=3000
    )
    later = replace(seen, latest={}, index=20)
    assert later.restart() == seen


def test_the_rate_is_that_of_the_recording_not_that_at_which_a_stream_plays(moving_rig: Path) -> None:
    rig = open_rig(moving_rig)
    slow = replace(rig, fps=10.0, timeline=replace(rig.timeline, rate=Fraction(25)))
    assert Ingest(slow).rate == 25
    assert Ingest(replace(slow, timeline=replace(rig.timeline, rate=None))).rate is None


def test_constants_are_kept_and_dropped_with_the_cameras_that_have_them() -> None:
    colours = {"a": Correction(falloff=5, lamp=ONE), "b": Correction(lamp=ONE), "c": Correction()}
    assert lamps_of(colours) == {"a": ONE, "b": ONE}
    assert with_lamps(colours, {}) == {"a": Correction(falloff=5), "c": Correction()}
    assert with_lamps(colours, {"b": TWO, "d": TWO}) == {
        **{"a": Correction(falloff=5), "b": Correction(lamp=TWO)},
        **{"c": Correction(), "d": Correction(lamp=TWO)},
    }
