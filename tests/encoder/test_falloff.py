"""Lenses that darken their borders: found at points that views share, taken out, kept in the header, shown again."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.codec.packets.corrections import FALLOFF_STEP, Correction
from decogs.decoder.cameras.corrections import apply_gain, darkening
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder.input.compensation.colour import remove_colours
from decogs.encoder.input.compensation.falloff import MIN_LOSS, Falloff, falloff_corrections, find_falloff
from decogs.formats.cameras import in_picture, project, scale_camera
from decogs.rig.pictures.ingest import View
from encode_rig import encode_rig
from outdoors.make import cameras, write_meadow
from shaded_walls import CORNER, FOCAL, LOSSES, SIZE, k_of, looking, wall


def found_on_wall(losses: Sequence[float], noise: float = 1.2, wrong: float = 0.0) -> tuple[list[View], Falloff]:
    """``wrong``: deviation of what each view shows in each place beside the wall's own colour, in levels."""
    views = [looking(index, len(losses)) for index in range(len(losses))]
    random = np.random.default_rng(5)
    xyz = np.stack([random.uniform(-3, 3, 6000), random.uniform(-2, 2, 6000), np.zeros(6000)], 1).astype(np.float32)
    seen = np.stack([in_picture(view.pinhole, *project(view.pinhole, xyz)) for view in views])
    pictures = []
    for index, (view, loss) in enumerate(zip(views, losses, strict=True)):
        picture = wall(view, 0.1 * (index - 2), loss, noise, index)
        blotches = random.normal(0, wrong / 255, (3, 6, 8))
        large = [cv2.resize(plane, SIZE, interpolation=cv2.INTER_CUBIC) for plane in blotches]
        pictures.append(np.asarray(picture + np.stack(large), np.float32))
    return views, find_falloff(views, pictures, xyz, seen)


def test_each_camera_s_fall_off_is_found_whatever_its_gain() -> None:
    views, found = found_on_wall(LOSSES)
    np.testing.assert_allclose(found.losses, LOSSES, atol=0.02)  # means of 3 x 3 pixels of a texture
    assert found.is_sure.tolist() == [loss >= MIN_LOSS for loss in LOSSES]
    corrections = falloff_corrections(views, found)
    likely = [corrections.get(view.camera.name, Correction()).falloff * FALLOFF_STEP for view in views]
    np.testing.assert_allclose(likely, [k_of(loss) for loss in LOSSES], atol=0.02)


def test_lenses_without_are_left_alone() -> None:
    views, found = found_on_wall([0.0] * 6)
    assert np.abs(found.losses).max() < 0.02
    assert falloff_corrections(views, found) == {}


def test_one_lens_among_others_is_found_and_they_are_not_blamed() -> None:
    views, found = found_on_wall([0, 0, 0, 0.3, 0, 0, 0])
    assert found.is_sure.tolist() == [False] * 3 + [True] + [False] * 3
    corrections = falloff_corrections(views, found)
    assert corrections["cam03"].falloff * FALLOFF_STEP == pytest.approx(k_of(0.3), abs=0.02)
    assert max(correction.falloff * FALLOFF_STEP for name, correction in corrections.items() if name != "cam03") < 0.02


def test_places_that_each_view_shows_in_its_own_way_are_no_fall_off() -> None:
    """Gloss and wrong points are wrong in groups: so many of them look like fall-offs of .1."""
    views, found = found_on_wall([0.0] * 6, wrong=25)
    assert np.abs(found.losses).max() > MIN_LOSS
    assert not found.is_sure.any()
    assert falloff_corrections(views, found) == {}


def test_a_view_without_points_has_what_the_others_have() -> None:
    k = np.array([0.30, 0.32, 0.28, 0.0])
    found = Falloff(k, np.array([0.01, 0.01, 0.01, np.inf]), np.full(4, CORNER))
    assert found.likely()[3] == pytest.approx(0.30, abs=0.01)
    np.testing.assert_allclose(found.likely()[:3], k[:3], atol=0.01)
    assert not found.is_sure[3]
    unknown = Falloff(np.zeros(4), np.full(4, np.inf), np.full(4, CORNER))
    assert not unknown.likely().any()


def test_a_brighter_border_is_no_lens_s() -> None:
    found = Falloff(np.array([-0.2, 0.3]), np.array([0.01, 0.01]), np.full(2, CORNER))
    assert found.likely()[0] == 0
    assert found.losses[0] < 0
    assert found.is_sure.tolist() == [False, True]


@pytest.mark.parametrize("brighter", [0.1, 0.9])
def test_borders_of_very_wide_lenses_that_seem_brighter_are_no_error(brighter: float) -> None:
    """At four times the width that a picture has from its distance, 1 + k t^2 could be below 0."""
    views = [looking(index, 4) for index in range(4)]
    wide = [replace(view.pinhole, fx=15.0, fy=15.0) for view in views]
    random = np.random.default_rng(5)
    xyz = np.stack([random.uniform(-7, 7, 4000), random.uniform(-6, 6, 4000), np.zeros(4000)], 1).astype(np.float32)
    seen = np.stack([in_picture(camera, *project(camera, xyz)) for camera in wide])
    rows, columns = np.indices((SIZE[1], SIZE[0])) + 0.5
    tangents = ((columns - 48) / 15) ** 2 + ((rows - 36) / 15) ** 2
    picture = np.repeat((0.05 + brighter * tangents / tangents.max())[None], 3, axis=0).astype(np.float32)
    found = find_falloff([View(camera, camera, None) for camera in wide], [picture] * 4, xyz, seen)
    assert np.isfinite(found.losses).all()
    assert (found.losses < 0).all()
    assert not found.is_sure.any()


def test_small_pictures_tell_nothing() -> None:
    """A point's colour is a mean of nine pixels, which then are of other things, too."""
    views = [looking(index, 5) for index in range(5)]
    small = [
        replace(view, camera=scale_camera(view.camera, 0.5), pinhole=scale_camera(view.pinhole, 0.5)) for view in views
    ]
    xyz = np.zeros((6000, 3), np.float32)
    xyz[:, :2] = np.random.default_rng(5).uniform([-3, -2], [3, 2], (6000, 2))
    seen = np.stack([in_picture(view.pinhole, *project(view.pinhole, xyz)) for view in small])
    pictures = [wall(view, 0, 0.4, 0.5, index) for index, view in enumerate(small)]
    found = find_falloff(small, pictures, xyz, seen)
    assert not found.is_sure.any()
    assert falloff_corrections(small, found) == {}


def test_few_points_tell_nothing() -> None:
    views = [looking(index, 3) for index in range(3)]
    pictures = [wall(view, 0, 0.3, 0, 0) for view in views]
    found = find_falloff(views, pictures, np.zeros((20, 3), np.float32), np.ones((3, 20), bool))
    assert not found.is_sure.any()
    assert not np.isfinite(found.deviation).any()


# What a decoder shows


@pytest.mark.parametrize("distortion", [(), (-0.25, 0.05, 0.0, 0.0)])
def test_light_falls_by_the_angle_to_the_axis(distortion: tuple[float, ...]) -> None:
    camera = replace(
        looking(1, 3).camera, distortion_model="opencv" if distortion else "none", distortion=distortion, cx=67.0
    )
    left = darkening(Correction(falloff=round(1 / FALLOFF_STEP)), camera)
    ways = np.array([[0.1, 0.2, 1], [-0.3, 0.1, 1], [0.4, -0.3, 1]])
    pinhole = replace(camera, distortion_model="none", distortion=(), world_to_camera=np.eye(4))
    u, v, _ = project(pinhole, ways)
    if distortion:
        x, y = ways[:, 0], ways[:, 1]
        radial = 1 + distortion[0] * (x**2 + y**2) + distortion[1] * (x**2 + y**2) ** 2
        u, v = x * radial * FOCAL + camera.cx, y * radial * FOCAL + camera.cy
    cosine = 1 / np.linalg.norm(ways, axis=1)
    # k = 1 is the law of the fourth power of the cosine; half a pixel is .7 % of it here.
    np.testing.assert_allclose(left[v.astype(int), u.astype(int)], cosine**4, rtol=0.015)


def test_what_is_taken_off_is_put_on_again() -> None:
    view, correction = looking(0, 3), Correction(exposure=300, red=-50, falloff=1500)
    shown = wall(view, 0, 0, 0, 0)
    factors = np.asarray(correction.odds_gain) * darkening(correction, view.pinhole)[..., None]
    recorded = apply_gain(shown.transpose(1, 2, 0), factors).transpose(2, 0, 1)
    np.testing.assert_allclose(remove_colours(recorded, correction, view.pinhole), shown, atol=1e-5)


# A whole encode

LEFT_OUT, LOSS = "cam06", 0.35


@pytest.fixture(scope="module")
def dark_borders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A meadow whose cameras lose a third of their corners' light."""
    clean = write_meadow("overcast", tmp_path_factory.mktemp("clean") / "rig", cameras(SIZE, 70)[::2], frames=2)
    rig = tmp_path_factory.mktemp("dark") / "rig"
    shutil.copytree(clean, rig)
    for camera in cameras(SIZE, 70)[::2]:
        dark = Correction(falloff=round(k_of(LOSS) * (FOCAL / camera.fx) ** 2 / FALLOFF_STEP))
        for path in sorted((rig / camera.name).iterdir()):
            picture = cv2.imread(str(path))
            assert picture is not None
            left = darkening(dark, camera)[..., None]
            recorded = apply_gain(np.asarray(picture / 255.0, np.float32), left * np.ones(3, np.float32))
            assert cv2.imwrite(str(path), np.rint(255 * recorded).astype(np.uint8))
    return rig


@pytest.mark.slow
def test_a_left_out_camera_is_better_and_a_trained_one_keeps_its_border(dark_borders: Path, tmp_path: Path) -> None:
    psnr = {}
    for name, effects in (("found", "motion,lens_falloff"), ("blind", "motion")):
        report = encode_rig(dark_borders, tmp_path / f"{name}.dgs", "live", holdout=[LEFT_OUT], effects=effects)
        psnr[name] = report.frames[0].held_out_psnr
    assert psnr["found"] is not None
    assert psnr["blind"] is not None
    assert psnr["found"] > psnr["blind"] + 0.5
    with open_stream(tmp_path / "blind.dgs") as stream:
        assert stream.header.effects == ("motion",)
        assert not stream.header.camera_colours
    with open_stream(tmp_path / "found.dgs", strict=True) as stream:
        header, frame = stream.header, next(stream.frames())
        assert header.effects == ("motion", "lens_falloff")
        assert header.camera_effects("cam00") == ("lens_falloff",)
        assert LEFT_OUT not in header.camera_colours
        trained = [camera for camera in header.cameras if camera.name != LEFT_OUT]
        k = [header.camera_colours[camera.name].falloff * FALLOFF_STEP for camera in trained]
        np.testing.assert_allclose(np.mean(k), k_of(LOSS) * (FOCAL / trained[0].fx) ** 2, rtol=0.15)
        as_recorded = render_view(header, frame.splats, "cam00", corrections=frame.corrections).image
        scene = render_view(header, frame.splats, "cam00").image
    corners = [(slice(4), slice(4)), (slice(-4, None), slice(-4, None))]
    for corner in corners:
        assert as_recorded[corner].mean() < 0.93 * scene[corner].mean()
    middle = slice(50, 70), slice(70, 90)
    assert as_recorded[middle].mean() == pytest.approx(scene[middle].mean(), rel=0.01)
