"""Held-out matches tell how well cameras fit: in pixels, and whether others fit better by more than chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.formats.cameras import Camera, project
from decogs.rig.calibration.features import Features
from decogs.rig.calibration.held_out import PairMatches, Score, score, split

COUNT = 200
PAIR = PairMatches(0, 1, np.zeros((0, 2), np.int64), np.stack([np.arange(COUNT)] * 2, axis=1))


def pair_of_cameras() -> dict[int, Camera]:
    """The second stands a unit to the right and is turned by .2 about the vertical; lines run along the rows."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(0.2), 0, np.sin(0.2)], [0, 1, 0], [-np.sin(0.2), 0, np.cos(0.2)]]
    pose[:3, 3] = -pose[:3, :3] @ [1.0, 0, 0]
    straight = Camera("a", 640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4))
    return {0: straight, 1: replace(straight, name="b", world_to_camera=pose)}


def seen_by(cameras: dict[int, Camera], up: np.ndarray) -> list[Features]:
    """Points far enough that lines are nearly rows; the second camera sees them ``up`` (COUNT,) pixels too high."""
    random = np.random.default_rng(0)
    points = random.uniform([-1, -0.2, 8], [1, 0.2, 10], (COUNT, 3))
    features = []
    for number, camera in cameras.items():
        pixels = np.stack(project(camera, points)[:2], axis=1) - number * np.stack([0 * up, up], axis=1)
        features.append(Features(pixels, np.zeros((COUNT, 128), np.float32), np.full(COUNT, -1)))
    return features


def score_of(up: np.ndarray) -> Score:
    cameras = pair_of_cameras()
    return score(cameras, seen_by(cameras, up), [PAIR])


def test_matches_off_their_lines_are_that_many_pixels_off() -> None:
    exact = score_of(np.zeros(COUNT))
    # Rounding of rays; the bound in the slope lets no distance be exactly 0.
    assert (exact.cost, exact.error) == pytest.approx((0, 0), abs=1e-6)
    assert exact.explained == 1
    # Either picture takes half: each is off by half a pixel's root, and lines are up to 2 % from upright.
    assert score_of(np.ones(COUNT)).error == pytest.approx(1, rel=0.02)


def test_wrong_matches_cost_three_pixels_and_are_not_in_the_error() -> None:
    up = np.full(COUNT, 0.5)
    up[: COUNT // 4] = 40
    wrong = score_of(up)
    assert wrong.explained == 0.75
    assert wrong.error == pytest.approx(0.5, rel=0.02)
    assert wrong.cost == pytest.approx(np.sqrt(0.25 * 3**2 + 0.75 * 0.5**2), rel=0.02)
    assert wrong.distances.max() == 3


def test_matches_of_a_camera_without_a_pose_count_as_wrong() -> None:
    cameras = pair_of_cameras()
    alone = score({0: cameras[0]}, seen_by(cameras, np.zeros(COUNT)), [PAIR])
    assert (alone.cost, alone.error, alone.explained) == (3, 3, 0)
    assert (alone.distances == 3).all()
    assert len(alone.distances) == COUNT


def test_cameras_are_better_where_more_than_chance_says_so() -> None:
    random = np.random.default_rng(1)
    one, other, worse = (score_of(random.normal(0, deviation, COUNT)) for deviation in (0.3, 0.3, 0.9))
    assert one.is_clearly_better(worse)
    assert not worse.is_clearly_better(one)
    assert not one.is_clearly_better(other)
    assert not other.is_clearly_better(one)


def test_an_eighth_of_the_points_is_held_out_of_all_pairs() -> None:
    """A point's matches between three cameras are held out together; else its place would be fitted to them."""
    cameras, every = pair_of_cameras(), np.stack([np.arange(COUNT)] * 2, axis=1)
    features = seen_by(cameras | {2: cameras[0]}, np.zeros(COUNT))
    pairs = split(features, {(0, 1): every, (1, 2): every, (0, 2): every})
    held = [set(pair.held_out[:, 0].tolist()) for pair in pairs]
    assert held[0] == held[1] == held[2]
    assert len(held[0]) == COUNT / 8
    for pair in pairs:
        assert held[0].isdisjoint(pair.fitted[:, 0].tolist())
        assert len(pair.fitted) + len(pair.held_out) == COUNT
