"""A camera's gain is told from a change of the scene's light, by points that several cameras see."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from decogs.rig.check.light import (
    EXPOSURE_LIMIT,
    FRAME_LIMIT,
    WHITE_BALANCE_LIMIT,
    Light,
    SharedPoints,
    light_at,
    light_overall,
    mismatch,
    own_light,
)

Gain = float | np.ndarray


def lit(picture: np.ndarray, gain: Gain) -> np.ndarray:
    """The picture with its linear light (sRGB) times ``gain``."""
    coded = picture / 255
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4) * gain
    linear = np.clip(linear, 0, 1)
    return np.rint(255 * np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055))


def points_of(cameras: int) -> tuple[SharedPoints, list[tuple[int, int]]]:
    """Points of the texture that cameras side by side have in common, and where in the texture each one's picture
    begins."""
    begins = [(3 * (camera % 5), 2 * (camera % 3)) for camera in range(cameras)]
    column, row = (grid.ravel() for grid in np.meshgrid(np.arange(25, 110, 8.0), np.arange(20, 90, 8.0)))
    first, second, here, there = [], [], [], []
    for a in range(cameras):
        for b in range(a + 1, min(a + 3, cameras)):
            for camera, numbers, pixels in ((a, first, here), (b, second, there)):
                numbers.append(np.full(len(column), camera))
                pixels.append(np.stack([column - begins[camera][0], row - begins[camera][1]], axis=1) + 0.5)
    joined = [np.concatenate(side or [np.empty(0, int)]) for side in (first, second)]
    places = [np.concatenate(side or [np.empty((0, 2))]) for side in (here, there)]
    return SharedPoints(joined[0], joined[1], places[0], places[1]), begins


Seen = Callable[..., Light]


@pytest.fixture
def seen(texture: np.ndarray, with_noise: Callable[..., np.ndarray]) -> Seen:
    """The light of cameras that see the texture as it is, then under each frame's ``light`` and each camera's gain.

    ``gains``: of a camera, one for every later frame, or a single one. ``light``: over the texture, likewise.
    """

    def look(*gains: Gain | Sequence[Gain], light: Sequence[Gain] = (1.0,)) -> Light:
        points, begins = points_of(len(gains))
        lights, overall = [], []
        for camera, (own, (left, top)) in enumerate(zip(gains, begins, strict=True)):
            every = own if isinstance(own, (list, tuple)) else [own] * len(light)
            scenes = [texture, *(lit(texture, there) for there in light)]
            pictures = [
                lit(scene[top : top + 100, left : left + 130], gain)
                for scene, gain in zip(scenes, [1.0, *every], strict=True)
            ]
            noisy = [with_noise(picture, 100 * camera + k) for k, picture in enumerate(pictures)]
            lights.append(light_at(np.stack(noisy), points.pixels_of(camera)))
            overall.append(light_overall(np.stack(noisy)))
        return own_light(points, lights, overall)

    return look


def drifting(light: Light) -> set[int]:
    """The cameras of which exposure or white balance are called for."""
    beyond = (light.exposure.max(axis=1) >= EXPOSURE_LIMIT) | (light.white_balance.max(axis=1) >= WHITE_BALANCE_LIMIT)
    return set(np.flatnonzero(beyond).tolist())


def wave(period: float, phase: float, size: float = 0.5) -> np.ndarray:
    return 1 + size * np.sin(2 * np.pi * np.arange(120) / period + phase)[:, None, None]


def test_a_gain_of_one_camera_is_its_own(seen: Seen) -> None:
    """The medians of points hold it to a twentieth of itself."""
    light = seen(1.0, 1.12, 1.0, 1.0)
    assert light.gains[1, 1, 0] == pytest.approx(np.log(1.12), rel=0.05)
    assert drifting(light) == {1}
    assert light.exposure[[0, 2, 3], 1].max() < EXPOSURE_LIMIT / 4
    assert light.white_balance.max() < WHITE_BALANCE_LIMIT / 4


def test_a_gain_of_red_is_white_balance(seen: Seen) -> None:
    light = seen(1.0, np.array([1.06, 1.0, 1.0]), 1.0)
    assert light.gains[1, 1, 1] == pytest.approx(np.log(1.06), rel=0.1)
    assert light.white_balance[1, 1] > WHITE_BALANCE_LIMIT
    assert light.exposure[1, 1] < EXPOSURE_LIMIT


WARMER = 0.55 * np.array([1.05, 1.0, 0.91])
LAMP = np.where(np.arange(160) < 70, 1.0, 1.6)[None, :, None]


@pytest.mark.parametrize(
    "light",
    [
        [0.9, 0.75, WARMER, WARMER],
        [1.0, 0.4, 1.0],
        [0.8, 1.1, 0.7, 1.2],
        [LAMP, LAMP * 0.8],
        [wave(60, 0.0), wave(60, 2.0), wave(60, 4.0)],
        [wave(20, 0.0), wave(20, 2.0)],
    ],
    ids=["dims and turns warmer", "jumps", "flickers", "a lamp", "a wide wave", "a narrow wave"],
)
def test_light_is_no_cameras(seen: Seen, light: list[Gain]) -> None:
    """Neither alone nor beside two cameras that drift, whose gains are found all the same."""
    assert drifting(seen(*[1.0] * 6, light=light)) == set()
    first, second = ([gain] * len(light) for gain in (1.1, 0.88))
    mixed = seen(1.0, first, 1.0, 1.0, second, 1.0, light=light)
    assert drifting(mixed) == {1, 4}
    np.testing.assert_allclose(mixed.gains[[1, 4], -1, 0], np.log([1.1, 0.88]), atol=0.015)


def test_one_of_four_cameras_drifts(seen: Seen) -> None:
    assert drifting(seen(1.0, 1.0, 1.08, 1.0, light=[0.7])) == {2}


def test_what_all_cameras_share_is_the_scenes(seen: Seen) -> None:
    light = seen(1.1, 1.1, 1.1, 1.1)
    assert drifting(light) == set()
    assert np.abs(light.gains).max() < FRAME_LIMIT


def test_all_cameras_that_drift_each_by_itself_are_found(seen: Seen) -> None:
    assert drifting(seen([1.1, 0.9], [0.92, 1.12], [1.15, 0.94], [0.88, 1.0], light=[1.0, 1.0])) == {0, 1, 2, 3}


def test_what_differs_from_place_to_place_in_one_camera_is_no_gain(seen: Seen) -> None:
    """Gloss, or a lamp that only this camera sees mirrored, on half of its picture."""
    mirrored = np.ones((1, 130, 1))
    mirrored[:, 60:] = 1.4
    assert drifting(seen(mirrored, 1.0, 1.0)) == set()


def test_a_gain_of_points_that_the_picture_does_not_show_is_none(texture: np.ndarray) -> None:
    """The points of one camera lie on what moves, a fifth of its picture, and all change alike; nothing else does."""
    points, _ = points_of(4)
    still = np.stack([texture, texture])
    lights = [light_at(still, points.pixels_of(camera)) for camera in range(4)]
    lights[1][1] += 0.2
    moving = still.copy()
    moving[1, : len(texture) // 5] = lit(texture, 1.3)[: len(texture) // 5]
    overall = [light_overall(pictures) for pictures in (still, moving, still, still)]
    assert drifting(own_light(points, lights, overall)) == set()
    moving[1] = lit(texture, np.exp(0.2))
    overall[1] = light_overall(moving)
    assert drifting(own_light(points, lights, overall)) == {1}


def test_two_cameras_cannot_be_told_apart(seen: Seen) -> None:
    for gains in ((1.12,), (1.0, 1.12)):
        light = seen(*gains)
        assert np.isnan(light.exposure).all()
        assert not light.drifts.any()


def test_a_camera_that_shares_nothing_is_not_told(texture: np.ndarray) -> None:
    points, _ = points_of(3)
    lights = [light_at(np.stack([texture, texture]), points.pixels_of(camera)) for camera in range(4)]
    overall = [light_overall(np.stack([texture, texture]))] * 4
    told = np.isfinite(own_light(points, lights, overall).exposure).all(axis=1)
    assert told.tolist() == [True, True, True, False]


def test_a_black_picture_tells_nothing() -> None:
    points, _ = points_of(3)
    black = np.zeros((3, 100, 130, 3), np.uint8)
    lights = [light_at(black, points.pixels_of(camera)) for camera in range(3)]
    light = own_light(points, lights, [light_overall(black)] * 3)
    assert np.isnan(light.exposure).all()
    assert not light.drifts.any()


def test_a_camera_whose_picture_never_changes_has_no_gain_among_those_that_drift(seen: Seen) -> None:
    """Most grow brighter, so that against their median, some 1.1, the steady one grows darker."""
    found = seen(1.0, 1.1, 1.12, 1.2, 0.9, 1.25, 1.07)
    np.testing.assert_array_equal(found.drifts, [False, False, False, True, True, True, False])


def told_apart(gains: Sequence[float], *, spread: float, seed: int) -> np.ndarray:
    """Shares (cameras,) of exposure that are found where each pair of cameras differs by ``spread``, and its points
    by .02 more."""
    rng = np.random.default_rng(seed)
    points, _ = points_of(len(gains))
    pairs, number = np.unique(points.first * len(gains) + points.second, return_inverse=True)
    seen_by_first = rng.normal(0, spread, len(pairs))[number] + rng.normal(0, 0.02, len(number))
    lights = []
    for camera, gain in enumerate(gains):
        own = np.concatenate([seen_by_first[points.first == camera], np.zeros((points.second == camera).sum())])
        lights.append(np.repeat((own + gain)[None, :, None], 3, axis=2) * [1, 0, 0])
    return np.asarray(mismatch(points, lights).shares[:, 0])


@pytest.mark.parametrize("seed", range(8))
def test_what_pairs_of_cameras_differ_by_is_no_mismatch(seed: int) -> None:
    """Shading that depends on the view is shared by a pair's points: hundreds of them are two to four observations."""
    assert np.abs(told_apart([0.0] * 8, spread=0.06, seed=seed)).max() < EXPOSURE_LIMIT


@pytest.mark.parametrize("seed", range(8))
def test_a_mismatched_camera_is_found_among_pairs_that_differ_a_little(seed: int) -> None:
    found = told_apart([0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0], spread=0.01, seed=seed)
    assert np.flatnonzero(np.abs(found) >= EXPOSURE_LIMIT).tolist() == [3]


def test_a_mismatch_that_is_sure_makes_no_other_sure() -> None:
    """Gloss of a few surfaces, that points of one camera scatter by, beside a camera of another exposure."""
    points, _ = points_of(6)
    rng = np.random.default_rng(0)
    few = np.isin(np.arange(len(points.first)) % 99, range(12))
    points = SharedPoints(points.first[few], points.second[few], points.first_pixels[few], points.second_pixels[few])
    lights = []
    for camera in range(6):
        count = ((points.first == camera) | (points.second == camera)).sum()
        scatter = np.abs(rng.normal(0, 0.3, count)) if camera == 2 else np.zeros(count)
        lights.append(np.repeat((scatter + 0.5 * (camera == 4))[None, :, None], 3, axis=2) * [1, 0, 0])
    shares = mismatch(points, lights).shares[:, 0]
    assert np.flatnonzero(np.abs(shares) >= EXPOSURE_LIMIT).tolist() == [4]
