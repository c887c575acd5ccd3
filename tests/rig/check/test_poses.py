"""Which cameras share surfaces, and whose pictures were exchanged, by matches on their epipolar lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from decogs.formats.cameras import Camera, project
from decogs.rig.check.matches import Features, Matches, PairMatches, matched, neighbouring
from decogs.rig.check.poses import connections, find_swaps, moments_of, suspected

WIDTH, HEIGHT, FOCAL = 352, 264, 300.0


def camera(number: int, degrees: float) -> Camera:
    """On a circle of radius 4, each at another height; all look at its middle."""
    angle, pose = np.radians(degrees), np.eye(4)
    forward = np.array([-np.sin(angle), 0.15 * (-1) ** number, np.cos(angle)])
    forward /= np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    pose[:3, :3], pose[2, 3] = np.stack([right, np.cross(forward, right), forward]), 4.0
    return Camera(f"cam{number:02d}", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)


LONG_ARC = [camera(number, 12.0 * number) for number in range(10)]
ARC = LONG_ARC[:6]


def pair(right: int, wrong: int) -> PairMatches:
    """So many matches of the first two cameras on their lines, and so many 20 pixels off."""
    points = np.random.default_rng(1).uniform(-0.8, 0.8, (right + wrong, 3))
    pixels = [np.stack(project(each, points)[:2], axis=1) for each in ARC[:2]]
    pixels[1][right:, 1] += 20
    rays = [(seen - [WIDTH / 2, HEIGHT / 2]) / FOCAL for seen in pixels]
    return PairMatches(0, 1, *pixels, *rays)


@pytest.mark.parametrize(
    ("right", "wrong", "is_connected"),
    [(8, 0, True), (7, 0, False), (20, 80, True), (10, 90, False)],  # eight, and 15 in a hundred
)
def test_cameras_are_connected_by_enough_matches_on_their_lines(right: int, wrong: int, is_connected: bool) -> None:
    found = connections(ARC[:2], Matches((pair(right, wrong),)))
    assert found == ([{1: right}, {0: right}] if is_connected else [{}, {}])


def features(order: Sequence[int], count: int = 80) -> list[Features]:
    """Of each camera, with the pictures of others in its place where ``order`` says so."""
    random = np.random.default_rng(2)
    points, words = random.uniform(-0.8, 0.8, (count, 3)), random.normal(size=(count, 128))
    words = (words / np.linalg.norm(words, axis=1, keepdims=True)).astype(np.float32)
    found = []
    for own, shown in zip(LONG_ARC, order, strict=False):
        pixels = np.stack(project(LONG_ARC[shown], points)[:2], axis=1)
        found.append(Features(pixels, np.empty((0, 2)), words).through(own))
    return found


def swaps(seen: list[Features]) -> list[tuple[int, int]]:
    cameras = LONG_ARC[: len(seen)]
    matches = Matches(tuple(matched(a, b, seen[a], seen[b]) for a, b in neighbouring(cameras)))
    return find_swaps(cameras, [seen], matches)[0]


def test_exchanged_pictures_are_found_and_those_in_their_places_are_left_there() -> None:
    assert swaps(features([0, 1, 2, 3, 4, 5])) == []
    assert swaps(features([0, 4, 2, 3, 1, 5])) == [(1, 4)]
    assert swaps(features([0, 4, 2, 3, 1, 5, 9, 7, 8, 6])) == [(1, 4), (6, 9)]


def test_pictures_that_stand_twice_are_not_exchanged() -> None:
    """Camera 4 has camera 1's pictures, whose own are lost: exchanged, only one of the two would fit better."""
    seen = features([0, 1, 2, 3, 1, 5])
    random = np.random.default_rng(3)
    lost = replace(seen[1], pixels=seen[1].pixels[random.permutation(len(seen[1].pixels))]).through(ARC[1])
    assert swaps([seen[0], lost, *seen[2:]]) == []


def test_moments_are_spread_evenly_from_the_first() -> None:
    assert moments_of(30) == [0, 10, 20]
    assert moments_of(1) == [0]


@pytest.mark.parametrize(("wrong", "expected"), [(25, []), (35, [4, 5])])  # of a hundred; below .7 of the usual share
def test_a_camera_is_suspected_when_far_fewer_of_its_matches_fit_than_of_others(
    wrong: int, expected: list[int]
) -> None:
    fitting = pair(100, 0)
    doubtful = replace(pair(100 - wrong, wrong), first=4, second=5)
    cameras = [*ARC[:2], *ARC[:2], *ARC[:2]]
    assert sorted(suspected(cameras, Matches((fitting, replace(fitting, first=2, second=3), doubtful)))) == expected
