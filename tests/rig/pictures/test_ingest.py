"""Ingest: planar pictures of pinhole views at the scale asked for, held-out cameras kept apart, lenses taken out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.decoder.cameras.lens import Undistortion
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest, display_referred


def read_png(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]


def test_pictures_are_the_files_planar_in_0_to_1(moving_rig: Path, tiny_rig: Any) -> None:
    ingest = Ingest(open_rig(moving_rig))
    frames = list(ingest.frames(1, 3))
    assert [frame.index for frame in frames] == [1, 2]
    assert [view.camera.name for view in ingest.views] == list(tiny_rig.names)
    for frame in frames:
        for view, picture in zip(ingest.views, frame.training, strict=True):
            file = read_png(moving_rig / view.camera.name / f"{frame.index:04d}.png")
            assert picture.dtype == np.float32
            assert picture.flags.c_contiguous
            np.testing.assert_array_equal(picture, file.transpose(2, 0, 1).astype(np.float32) / np.float32(255))
            assert view.valid is None
        assert frame.held_out == []


def test_held_out_cameras_are_kept_apart(moving_rig: Path) -> None:
    ingest = Ingest(open_rig(moving_rig), holdout=["cam03", "cam01"])
    frame = next(ingest.frames(0, 1))
    assert [view.camera.name for view in ingest.views] == ["cam00", "cam02", "cam04"]
    assert [view.camera.name for view in ingest.held_out_views] == ["cam01", "cam03"]
    for views, pictures in ((ingest.views, frame.training), (ingest.held_out_views, frame.held_out)):
        for view, picture in zip(views, pictures, strict=True):
            file = read_png(moving_rig / view.camera.name / "0000.png")
            np.testing.assert_array_equal(np.rint(picture * 255), file.transpose(2, 0, 1))


def test_half_size_is_the_mean_of_four_pixels_seen_by_the_scaled_camera(moving_rig: Path, tiny_rig: Any) -> None:
    ingest = Ingest(open_rig(moving_rig), scale=0.5)
    picture = next(ingest.frames(0, 1)).training[0]
    file = read_png(moving_rig / "cam00" / "0000.png").astype(np.float64)
    means = file.reshape(tiny_rig.height // 2, 2, tiny_rig.width // 2, 2, 3).mean(axis=(1, 3)).transpose(2, 0, 1)
    np.testing.assert_allclose(picture * 255, means, atol=0.51)  # rounded to 8 bit
    camera, full = ingest.views[0].pinhole, tiny_rig.camera(0)
    assert (camera.width, camera.height) == (tiny_rig.width // 2, tiny_rig.height // 2)
    assert (camera.fx, camera.cx, camera.cy) == (full.fx / 2, full.cx / 2, full.cy / 2)
    assert ingest.cameras[0].width == full.width, "decoded views lie over the original videos"


def test_a_lens_is_taken_out_and_unrecorded_pixels_take_the_nearest_recorded_one(lens_rig: Path) -> None:
    ingest = Ingest(open_rig(lens_rig))
    picture = next(ingest.frames(0, 1)).training[1]
    view = ingest.views[1]
    assert view.camera.distortion_model == "opencv"
    assert view.pinhole.distortion_model == "none"
    assert view.valid is not None
    recorded = view.valid.astype(bool)
    assert 0 < (~recorded).sum() < recorded.size / 4
    plain = Undistortion(view.camera).apply(read_png(lens_rig / "cam01" / "0000.png"))
    np.testing.assert_array_equal(np.rint(picture[:, recorded] * 255), plain[recorded].T)
    rows, columns = np.nonzero(recorded)
    for row, column in zip(*np.nonzero(~recorded), strict=True):
        distances = np.hypot(rows - row, columns - column)
        near = distances <= 1.05 * distances.min()  # the distance transform's 5x5 mask is off by up to 2 %
        candidates = picture[:, rows[near], columns[near]]
        assert (candidates == picture[:, row, column][:, None]).all(axis=0).any()


def test_display_referred_codes_linear_light_as_srgb() -> None:
    # Worked values of IEC 61966-2-1; 8-bit pictures are display-referred already.
    linear = np.array([[[-1.0, 0.0, 0.002], [0.0031308, 0.18, 0.5], [1.0, 7.0, 0.2140]]], np.float32)
    expected = [[[0.0, 0.0, 0.02584], [0.04045, 0.46136, 0.73536], [1.0, 1.0, 0.5]]]
    np.testing.assert_allclose(display_referred(linear), expected, atol=5e-5)
    assert display_referred(linear).dtype == np.float32
    levels = np.arange(256, dtype=np.uint8).reshape(1, 256, 1)
    np.testing.assert_array_equal(display_referred(levels).ravel(), np.arange(256, dtype=np.float32) / np.float32(255))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 0.0}, r"`scale` 0: give a number above 0"),
        ({"scale": -1.0}, r"`scale` -1"),
        ({"scale": float("nan")}, r"`scale` nan"),
        ({"scale": 5.0}, r"`scale` 5: .* at most 4"),
        ({"holdout": ["cam02", "nope"]}, r"`holdout` nope: .* no such camera; it has cam00, cam01"),
        ({"holdout": [f"cam{i:02d}" for i in range(5)]}, r"every camera is held out"),
    ],
)
def test_impossible_options_are_refused(moving_rig: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Ingest(open_rig(moving_rig), **options)


def test_a_camera_does_not_see_its_own_housing(moving_rig: Path) -> None:
    """Every camera, held out or not, gets a near plane at a tenth of the median depth of the points it sees."""
    ingest = Ingest(open_rig(moving_rig), holdout=["cam00"])
    camera = ingest.views[0].pinhole
    inward = camera.world_to_camera[2, :3]
    centre = -camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3]
    points = np.float32([centre + inward * depth for depth in (1.0, 2.0, 4.0)])
    ingest.place_near_planes(points)
    # Depths come from float32 points: 1e-6 of the largest.
    assert ingest.views[0].pinhole.near == pytest.approx(0.2, abs=4e-6)
    assert ingest.views[0].camera.near == ingest.views[0].pinhole.near
    assert {c.name: c.near for c in ingest.cameras}[camera.name] == ingest.views[0].pinhole.near
