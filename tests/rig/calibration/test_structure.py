"""Cameras and lenses from matches of points that are drawn at random, and how certain they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.decoder.cameras.lens import distort_pixels, with_k1
from decogs.formats.cameras import Camera, as_pinhole, project
from decogs.formats.rigs import open_rig
from decogs.rig.calibration.by_motion import _explained, believed, is_mirrored, moving_cameras
from decogs.rig.calibration.certainty import focal_deviations
from decogs.rig.calibration.features import Features, features_of, matched, sift_extractor
from decogs.rig.calibration.footage import Footage, instants_of, pictures_at
from decogs.rig.calibration.given import Given
from decogs.rig.calibration.held_out import split
from decogs.rig.calibration.lenses import Lens
from decogs.rig.calibration.placed import Calibration
from decogs.rig.calibration.structure import Mapped, Matched, map_cameras

pytest.importorskip("pycolmap", reason="pip install 'decogs[calibrate]'")

FOCAL, SIZE = 500.0, (640, 480)
NOISE = 0.2
"""Pixels: about SIFT's."""


def arc(count: int, k1: float = 0.0) -> list[Camera]:
    """Cameras 12 degrees apart that look at the origin from four units away, in two rows."""
    cameras = []
    for number, angle in enumerate(np.radians(12.0 * (np.arange(count) - count / 2))):
        forward = -np.array([np.sin(angle), 0.1 - 0.2 * (number % 2), -np.cos(angle)])
        forward /= np.linalg.norm(forward)
        right = np.cross([0, 1.0, 0], forward) / np.linalg.norm(np.cross([0, 1.0, 0], forward))
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[:3, 3] = [0, 0, 4.0]
        cameras.append(with_k1(Camera(f"cam{number}", *SIZE, FOCAL, FOCAL, 320, 240, pose), k1))
    return cameras


def matched_points(cameras: Sequence[Camera], seed: int, points: int = 160) -> Matched:
    """Every point is seen by every camera, with errors."""
    draw = np.random.default_rng(seed)
    places = draw.uniform(-1, 1, (points, 3))
    features = []
    for camera in cameras:
        pixels = distort_pixels(camera, np.stack(project(camera, places)[:2], axis=1))
        noisy = pixels + draw.normal(0, NOISE, pixels.shape)
        features.append(Features(noisy, np.zeros((points, 128), np.float32), np.full(points, -1)))
    every = np.stack([np.arange(points)] * 2, axis=1)
    pairs = split(features, {(a, b): every for a in range(len(cameras)) for b in range(a + 1, len(cameras))})
    return Matched([camera.name for camera in cameras], [SIZE] * len(cameras), features, pairs, False)


def placed(cameras: Sequence[Camera], seed: int) -> Mapped:
    mapped = map_cameras(matched_points(cameras, seed), 0, lambda: None)
    assert mapped is not None
    assert len(mapped.cameras) == len(cameras)
    return mapped


@pytest.mark.parametrize(("count", "k1"), [(3, 0.0), (4, 0.0), (6, 0.0), (6, -0.2)])
def test_no_focal_length_is_off_by_more_than_is_said(count: int, k1: float) -> None:
    for seed in range(2):
        mapped = placed(arc(count, k1), seed)
        for number, camera in mapped.cameras.items():
            assert abs(camera.fx / FOCAL - 1) < mapped.focal_errors[number] < 0.1


@pytest.mark.parametrize("count", [3, 4])
def test_axes_that_are_off_the_middle_each_to_another_side_count(count: int) -> None:
    """By 1 % of the width. With a deviation of .3 %, whatever residuals tell, 4.4 and 2.6 % are said of 5.4 and 4.7."""
    ways = np.random.default_rng(15).uniform(0, 2 * np.pi, count)
    shifts = 0.01 * SIZE[0] * np.stack([np.cos(ways), np.sin(ways)], axis=1)
    cameras = [replace(camera, cx=320 + x, cy=240 + y) for camera, (x, y) in zip(arc(count), shifts, strict=True)]
    mapped = placed(cameras, 5)
    for number, camera in mapped.cameras.items():
        assert abs(camera.fx / FOCAL - 1) < mapped.focal_errors[number] < 0.12


def test_a_lens_bends_where_pictures_say_so_and_nowhere_else() -> None:
    assert placed(arc(5), 0).cameras[0].distortion_model == "none"
    bent = placed(arc(5, -0.2), 0).cameras[0]
    assert bent.distortion_model == "opencv"
    assert bent.distortion[0] == pytest.approx(-0.2, abs=0.05)  # five of its standard deviations


def test_a_mirrored_camera_changes_nothing_of_the_others() -> None:
    """Near the middle its points lie nearly where they should; with those, the others' focal lengths are 4 % off."""
    start = matched_points(arc(4), seed=2)
    pixels = start.features[3].pixels * [-1, 1] + [SIZE[0], 0]
    features = [*start.features[:3], replace(start.features[3], pixels=pixels)]
    near = np.flatnonzero(np.abs(pixels[:, 0] - SIZE[0] / 2) < 60)
    rows = {True: np.stack([near] * 2, axis=1), False: np.stack([np.arange(len(pixels))] * 2, axis=1)}
    start = replace(
        start, features=features, pairs=split(features, {pair: rows[3 in pair] for pair in combinations(range(4), 2)})
    )
    footage: Any = [SimpleNamespace(name=name, size=SIZE) for name in start.names]
    mapped, found = believed(start, footage, 0)
    assert mapped is not None
    assert list(found.not_connected) == ["cam3"]
    for number, camera in mapped.cameras.items():
        assert abs(camera.fx / FOCAL - 1) < mapped.focal_errors[number] < 0.1


@pytest.mark.slow
def test_four_lenses_that_bend_are_found_from_pictures(shared_data: Callable[[str], Path]) -> None:
    """With every residual below two pixels counted alike, focal lengths come out 13 to 15 % too long."""
    rig, extractor = open_rig(shared_data("rigs/workbench")), sift_extractor()
    cameras = [camera for camera in rig.cameras if camera.name in ("cam05", "cam06", "cam11", "cam12")]
    features = []
    for camera, source in zip(rig.cameras, rig.sources, strict=True):
        if camera in cameras:
            footage = Footage(camera.name, source)
            straight = features_of(list(pictures_at(footage, instants_of([footage], 8))), extractor)
            pixels = distort_pixels(with_k1(as_pinhole(camera), -0.15), straight.pixels)
            features.append(replace(straight, pixels=pixels))
    pairs = {(a, b): matched(features[a], features[b]) for a, b in combinations(range(4), 2)}
    sizes = [(camera.width, camera.height) for camera in cameras]
    start = Matched([camera.name for camera in cameras], sizes, features, split(features, pairs), False)
    mapped = map_cameras(start, 0, lambda: None)
    assert mapped is not None
    for number, camera in enumerate(cameras):
        assert abs(mapped.cameras[number].fx / camera.fx - 1) < mapped.focal_errors[number] < 0.05
        assert mapped.cameras[number].distortion[0] == pytest.approx(-0.15, abs=0.02)


def test_deviations_are_the_spread_of_focal_lengths_over_many_takes() -> None:
    takes = [placed(arc(4), seed) for seed in range(8)]
    focal = np.array([[mapped.cameras[number].fx / FOCAL for number in range(4)] for mapped in takes])
    # The lenses here have their axis in the middle.
    said = np.array([list(focal_deviations(mapped.model, "lens", centre=1e-6).values()) for mapped in takes])
    spread = np.sqrt(((focal - 1) ** 2).mean())
    assert 0.5 < spread / np.sqrt((said**2).mean()) < 2  # 32 figures, of which the four of a take hang together


def test_points_that_leave_focal_lengths_open_are_said_to() -> None:
    """Few cameras, a free principal point: nothing is said to be known (to less than a tenth)."""
    mapped = placed(arc(3), 0)
    assert min(focal_deviations(mapped.model, "centre").values()) > 0.02


def lenses(focal: Sequence[float]) -> Given:
    return Given(Path("lenses"), tuple(Lens("none", (one, one), (319.5, 239.5), (0.0,) * 4) for one in focal))


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ([500.0] * 5, {}),
        ([500.0, 500, 550, 500, 500], {2: 500}),
        ([450.0] * 5, dict.fromkeys(range(5), 500)),
    ],
)
def test_given_focal_lengths_stay_and_wrong_ones_are_named(given: list[float], wrong: dict[int, float]) -> None:
    start = replace(matched_points(arc(5), 0), given=lenses(given))
    mapped = map_cameras(start, 0, lambda: None)
    assert mapped is not None
    assert [camera.fx for _, camera in sorted(mapped.cameras.items())] == given
    assert mapped.misfits == pytest.approx(wrong, rel=0.02)  # from where a misfit counts


def test_exchanged_videos_of_unlike_lenses_are_named() -> None:
    cameras = arc(5)
    cameras[1] = replace(cameras[1], fx=650.0, fy=650.0)
    start = replace(matched_points(cameras, 0), given=lenses([500, 500, 500, 650, 500]))
    mapped = map_cameras(start, 0, lambda: None)
    assert mapped is not None
    assert sorted(mapped.misfits) == [1, 3]


def test_a_camera_whose_whole_picture_moves_is_named() -> None:
    assert list(moving_cameras({"a": 0.6, "b": 0.7, "c": 0.1, "d": 0.1, "e": 0.2})) == ["a", "b"]
    assert not moving_cameras(dict.fromkeys("abc", 0.9)), "everything moves"


@pytest.mark.parametrize(("shift", "least", "most"), [(0, 0, 0.2), (3, 5, 7)])
def test_a_camera_that_is_knocked_shows_it(shift: int, least: float, most: float) -> None:
    """In pictures 320 wide, from the third on, while something passes through a tenth of them."""
    draw = np.random.default_rng(4)
    blurred = cv2.GaussianBlur(draw.integers(0, 256, (240, 330), np.uint8), (0, 0), 2)
    scene = cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX)
    pictures = []
    for instant in range(4):
        start = shift if instant > 1 else 0
        picture = scene[:, start : start + 320].copy()
        picture[80:160, 40 * instant : 100 + 40 * instant] = 200
        pictures.append(np.repeat(picture[..., None], 3, axis=2))
    assert least <= features_of(pictures, sift_extractor()).shifted <= most


def test_a_word_takes_the_place_of_a_reason_and_is_a_doubt_of_others() -> None:
    found = _explained(Calibration((), {"b": "is lost", "c": "is lost"}, "", ""), {"a": "moves", "b": "moves"})
    assert found.not_connected == {"b": "moves", "c": "is lost"}
    assert found.doubts == {"a": "moves"}


def test_mirrored_pictures_match_when_they_are_turned() -> None:
    draw = np.random.default_rng(2)
    shapes = cv2.GaussianBlur(draw.integers(0, 256, (48, 64), np.uint8), (0, 0), 0.8)
    picture = np.repeat(cv2.resize(shapes, (512, 384))[..., None], 3, axis=2)
    moved = np.ascontiguousarray(np.roll(picture, 20, axis=1))
    other, own, turned = (
        features_of([one], sift_extractor()) for one in (moved, np.ascontiguousarray(picture[:, ::-1]), picture)
    )
    assert is_mirrored(own, turned, [other])
    assert not is_mirrored(turned, own, [other])
