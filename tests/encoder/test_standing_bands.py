"""Bands of lamps that stand still are found at points that cameras see in other rows, beside fall-off and gains."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import ALWAYS_LIT, LAMP_STEP, Correction
from decogs.decoder.cameras.corrections import as_recorded
from decogs.decoder.rendering.views import correction_of
from decogs.encoder.input.compensation.falloff import falloff_of
from decogs.encoder.input.compensation.frame import find_camera_colours, match_colours
from decogs.encoder.input.compensation.point_fit import PointFit, shared_points
from decogs.encoder.input.compensation.standing_bands import band_corrections, find_bands
from decogs.encoder.settings.effects import CorrectionSettings
from decogs.formats.cameras import in_picture, project
from decogs.rig.check.lamps import standing_hertz
from decogs.rig.pictures.ingest import RigFrame, View
from shaded_walls import LOSSES, looking, wall

VIEWS = [looking(index, 6) for index in range(6)]
TURNS = (1.5, 1.65, 1.75, 1.55, 1.6, 1.7)


def banded(view: View, picture: np.ndarray, strength: float, turns: float, phase: float) -> np.ndarray:
    rows = (np.arange(view.pinhole.height) + 0.5) / view.pinhole.height
    light = 1 + strength * np.sin(2 * np.pi * turns * rows + phase)[:, None]
    return np.asarray(light * picture / (1 + (light - 1) * picture), np.float32)


def recorded(
    strength: float, *, losses: tuple[float, ...] = (0.0,) * 6
) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Pictures of a wall, each camera with a gain and a phase of its own, and points of it as the views see them."""
    pictures = [
        banded(view, wall(view, 0.1 * (index - 2), losses[index], 1.2, index), strength, TURNS[index], 2.3 * index)
        for index, view in enumerate(VIEWS)
    ]
    random = np.random.default_rng(5)
    xyz = np.stack([random.uniform(-3, 3, 6000), random.uniform(-2, 2, 6000), np.zeros(6000)], 1).astype(np.float32)
    return pictures, xyz, np.stack([in_picture(view.pinhole, *project(view.pinhole, xyz)) for view in VIEWS])


@pytest.mark.parametrize("losses", [(0.0,) * 6, LOSSES], ids=["no fall-off", "fall-off"])
def test_bands_are_found_beside_fall_off(losses: tuple[float, ...]) -> None:
    points = shared_points(VIEWS, *recorded(0.15, losses=losses))
    fit = PointFit(points)
    fit.fit()
    waved, sure = find_bands(points, fit)
    assert sure.all()
    assert waved.turns is not None
    np.testing.assert_allclose(waved.turns, TURNS, atol=0.1)
    strengths = np.hypot(*waved.waves)
    assert strengths.min() > 0.08, "what the cameras share looks like the wall's own"
    assert strengths.max() < 0.18
    np.testing.assert_allclose(falloff_of(waved, points).losses, losses, atol=0.05)


@pytest.mark.parametrize("losses", [(0.0,) * 6, LOSSES], ids=["no fall-off", "fall-off"])
def test_where_there_are_none_none_are_found(losses: tuple[float, ...]) -> None:
    points = shared_points(VIEWS, *recorded(0.0, losses=losses))
    fit = PointFit(points)
    fit.fit()
    same, sure = find_bands(points, fit)
    assert same is fit
    assert not sure.any()
    assert band_corrections(VIEWS, fit, sure, 100.0) == {}


@pytest.mark.parametrize(
    ("rate", "hertz"), [(25, (100.0,)), (50, (100.0,)), (24, (120.0,)), (30, (120.0,)), (29, ()), (None, ())]
)
def test_frame_rates_at_which_lamps_stand_still(rate: float | None, hertz: tuple[float, ...]) -> None:
    assert standing_hertz(rate) == hertz


def test_pictures_are_without_them_and_a_decoder_shows_them_again() -> None:
    """Taken out of every frame alike; at a rate at which they would wander nobody looks for them."""
    pictures, xyz, seen = recorded(0.15)
    frame, settings = RigFrame(0, pictures, []), CorrectionSettings(standing_bands=True)
    assert find_camera_colours(frame, 29.0, VIEWS, settings, xyz, seen) == {}
    colours = find_camera_colours(frame, 25.0, VIEWS, settings, xyz, seen)
    assert set(colours) == {view.camera.name for view in VIEWS}
    steady = match_colours(frame, VIEWS, colours).training
    for index, view in enumerate(VIEWS):
        clean = wall(view, 0.1 * (index - 2), 0, 1.2, index)
        before, after = (np.abs(picture - clean).mean() for picture in (pictures[index], steady[index]))
        assert after < 0.7 * before
        own = colours[view.camera.name]
        assert own.lamp is not None
        assert (own.lamp_amplitude, own.lamp.hertz) == (ALWAYS_LIT, 100.0)
        again = as_recorded(steady[index].transpose(1, 2, 0), own, view.camera)
        np.testing.assert_allclose(again.transpose(2, 0, 1), pictures[index], atol=2e-5)


def test_a_header_keeps_them() -> None:
    from decogs.codec.scene.lattice import default_lattice

    wave = Correction(lamp_amplitude=ALWAYS_LIT, lamp=band_lamp())
    header = StreamHeader(
        cameras=tuple(view.camera for view in VIEWS),
        lattice=default_lattice(2.0),
        effects=("lamp_flicker",),
        camera_colours={"cam01": wave},
    )
    read = StreamHeader.from_bytes(header.to_bytes())
    assert read.camera_colours == {"cam01": wave}
    assert read.camera_effects("cam01") == ("lamp_flicker",)
    assert correction_of(read, "cam01", {}) == wave
    assert correction_of(read, "cam02", {}) is None


def band_lamp():
    points = shared_points(VIEWS, *recorded(0.15))
    fit = PointFit(points)
    fit.fit()
    waved, sure = find_bands(points, fit)
    lamp = band_corrections(VIEWS, waved, sure, 120.0)["cam01"].lamp
    assert lamp is not None
    assert 120 * lamp.readout == pytest.approx(TURNS[1], abs=0.1)
    assert np.hypot(lamp.sine[0], lamp.cosine[0]) * LAMP_STEP == pytest.approx(0.09, abs=0.02)
    return lamp


def test_without_points_nothing_is_known() -> None:
    """Of small pictures, too: no warning of empty means comes of it."""
    pictures, xyz, seen = recorded(0.15)
    settings = CorrectionSettings(standing_bands=True)
    for points in (0, 3, 60):
        frame = RigFrame(0, pictures, [])
        assert find_camera_colours(frame, 25.0, VIEWS, settings, xyz[:points], seen[:, :points]) == {}
