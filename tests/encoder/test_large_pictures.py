"""Large pictures: which steps see them shrunk, and that a shrunk picture is what a smaller camera records."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.decoder.cameras.resizing import resized
from decogs.encoder.keyframe.large_pictures import (
    PictureScale,
    fit_to_pictures,
    shrunk_camera,
    shrunk_weights,
    unscaled_schedule,
)
from decogs.encoder.settings.keyframe import KeyframeSettings
from decogs.encoder.settings.presets import PRESETS
from decogs.formats.cameras import Camera, project

SETTINGS = KeyframeSettings(iterations=1000, cap=1000)


def camera(width: int, height: int) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = 0.1, -0.2, 2.0
    return Camera("a", width, height, 1.1 * width, 1.2 * width, 0.45 * width, 0.55 * height, pose)


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((490, 489), [(0, 1)]),
        ((490, 490), [(0, 2), (525, 1)]),
        ((960, 540), [(0, 2), (525, 1)]),
        ((1352, 1014), [(0, 4), (262, 2), (525, 1)]),
        ((3840, 2160), [(0, 8), (175, 4), (350, 2), (525, 1)]),
    ],
)
def test_the_first_steps_see_pictures_of_at_least_60_000_pixels(
    size: tuple[int, int], expected: list[tuple[int, int]]
) -> None:
    scales = fit_to_pictures([size[0] * size[1]], SETTINGS).scales
    assert scales == tuple(PictureScale(*each) for each in expected)
    smallest = shrunk_camera(camera(*size), scales[0].factor)
    assert smallest.width * smallest.height >= 60_000 * 0.99


def test_where_pictures_are_larger_first_points_are_fewer_and_steps_longer_and_fewer() -> None:
    fits = [
        fit_to_pictures([size[0] * size[1]], SETTINGS) for size in ((500, 480), (692, 694), (1000, 960), (2000, 1920))
    ]
    np.testing.assert_allclose([fit.longer for fit in fits], [1, 2**0.5, 2, 4], rtol=1e-3)
    assert [fit.first_points for fit in fits] == [1000, 707, 500, 500]
    assert [fit.iterations for fit in fits] == [750] * 4


def test_step_sizes_have_most_of_their_fall_after_the_pictures_have_their_own_size() -> None:
    large, small = fit_to_pictures([1352 * 1014], SETTINGS), fit_to_pictures([352 * 264], SETTINGS)
    at = [0.0, 0.35, 0.7, 0.85, 1.0]
    np.testing.assert_allclose([large.rate_progress(each) for each in at], [0, 0.1, 0.2, 0.6, 1])
    assert [small.rate_progress(each) for each in at] == at


@pytest.mark.parametrize("size", [(352, 264), (336, 252), (640, 360)])
def test_pictures_of_the_size_that_presets_were_tuned_on_keep_the_schedule(size: tuple[int, int]) -> None:
    for settings in PRESETS.values():
        assert fit_to_pictures([size[0] * size[1]] * 12, settings.keyframe) == unscaled_schedule(settings.keyframe)


@pytest.mark.parametrize("factor", [2, 4])
def test_a_shrunk_pixel_is_the_mean_of_those_that_it_covers_and_lies_where_the_shrunk_camera_sees_them(
    factor: int,
) -> None:
    own = camera(32, 24)
    small = shrunk_camera(own, factor)
    picture = np.random.default_rng(0).random((3, 24, 32)).astype(np.float32)
    blocks = picture.reshape(3, 24 // factor, factor, 32 // factor, factor).mean(axis=(2, 4))
    np.testing.assert_allclose(resized(picture, small), blocks, atol=1e-6)
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 3))
    for large, little in zip(project(own, points)[:2], project(small, points)[:2], strict=True):
        np.testing.assert_allclose(little, large / factor, rtol=1e-12)


def test_a_size_that_does_not_divide_keeps_a_ramp_where_it_was() -> None:
    own = camera(33, 21)
    small = shrunk_camera(own, 2)
    ramp = np.broadcast_to((np.arange(33, dtype=np.float32) + 0.5) / 33, (3, 21, 33)).copy()
    expected = (np.arange(small.width) + 0.5) / small.width
    np.testing.assert_allclose(resized(ramp, small), np.broadcast_to(expected, (3, 10, 16)), atol=2e-3)


def test_a_shrunk_pixel_counts_only_if_all_do_that_it_covers() -> None:
    counted = np.ones((24, 32), np.float32)
    counted[5, 9] = 0
    expected = np.ones((12, 16), np.float32)
    expected[2, 4] = 0
    np.testing.assert_array_equal(shrunk_weights(counted, shrunk_camera(camera(32, 24), 2)), expected)
    assert shrunk_weights(None, camera(32, 24)) is None
