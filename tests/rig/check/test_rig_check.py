"""The verdict on a rig: cameras that are turned or late are named and no others; what new views can look like."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera, project
from decogs.rig.check.matches import Features, Matches, PairMatches, features_of, neighbouring
from decogs.rig.check.rig_check import RIGHT, WRONG, _matches_in_place, judge_rig

WIDTH, HEIGHT, FOCAL = 352, 264, 300.0


def looking_in(degrees: Sequence[float], height: float = 0.0) -> list[Camera]:
    """Cameras on a circle of radius 4 around the origin, which they look at."""
    cameras = []
    for number, angle in enumerate(np.radians(degrees)):
        forward = np.array([-math.sin(angle), height * (-1) ** number / 4, math.cos(angle)])
        forward /= np.linalg.norm(forward)
        right = np.cross([0.0, 1.0, 0.0], forward)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        pose[2, 3] = 4.0
        cameras.append(Camera(f"cam{number:02d}", WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose))
    return cameras


def matches_of(cameras: Sequence[Camera], wrong: float = 0.2, spread: float = 1.0) -> Matches:
    """What matching finds of 300 points: one pixel in all pairs of a camera, .3 pixels of noise, and wrong ones."""
    rng = np.random.default_rng(3)
    points = spread * rng.uniform(-1, 1, (300, 3)) * [1.2, 1.0, 1.2]
    seen = [np.stack(project(camera, points)[:2], axis=1) + rng.normal(0, 0.3, (300, 2)) for camera in cameras]
    pairs = []
    for one, two in neighbouring(cameras):
        rows, partners = np.arange(300), np.arange(300)
        mistaken = rng.random(300) < wrong
        partners[mistaken] = rng.permutation(partners[mistaken])
        pixels = seen[one][rows], seen[two][partners]
        rays = [(side - [WIDTH / 2, HEIGHT / 2]) / FOCAL for side in pixels]
        pairs.append(PairMatches(one, two, *pixels, *rays))
    return Matches(tuple(pairs))


def turned_by_a_degree(camera: Camera, axis: int) -> Camera:
    rotation = cv2.Rodrigues(np.radians(np.eye(3)[axis]))[0]
    pose = camera.world_to_camera.copy()
    pose[:3] = rotation @ pose[:3]
    return replace(camera, world_to_camera=pose)


ARC, AROUND = np.arange(7) * 9.0, np.arange(12) * 30.0
UNKNOWN = np.full(12, np.nan)


@pytest.mark.parametrize("degrees", [ARC, AROUND], ids=["arc", "around"])
def test_a_rig_as_calibrated_is_not_warned_of(degrees: np.ndarray) -> None:
    cameras = looking_in(degrees, height=1.0)
    check = judge_rig(cameras, matches_of(cameras), UNKNOWN)
    assert list(check.warnings()) == []
    # Noise of .3 pixels at a focal length of 300 is .06 degrees for one match; depths known from one side add to it.
    assert not any(camera.turned > 0.2 for camera in check.cameras)


@pytest.mark.parametrize("axis", [0, 1, 2], ids=["tilted", "panned", "rolled"])
@pytest.mark.parametrize("degrees", [ARC, AROUND], ids=["arc", "around"])
def test_a_camera_turned_by_a_degree_is_named_and_no_other(degrees: np.ndarray, axis: int) -> None:
    """In an arc, too, where a pan moves matches along their epipolar lines."""
    cameras = looking_in(degrees, height=1.0)
    found = matches_of(cameras)
    cameras[3] = turned_by_a_degree(cameras[3], axis)
    check = judge_rig(cameras, found, UNKNOWN)
    assert [camera.camera for camera in check.cameras if camera.misplaced] == ["cam03"]
    assert check.cameras[3].turned == pytest.approx(1.0, abs=0.15)
    (warning,) = check.warnings()
    assert warning.startswith(("camera cam03 appears rotated by 1.0 degrees", "camera cam03 appears rotated by 0.9"))


@pytest.mark.parametrize(("spread", "named"), [(0.02, []), (0.3, ["cam03"])])
def test_a_roll_about_matches_in_one_place_counts_where_it_shows(spread: float, named: list[str]) -> None:
    """A degree moves matches within 2 pixels of each other by hundredths, which their errors hide."""
    cameras = looking_in(ARC, height=1.0)
    found = matches_of(cameras, wrong=0.0, spread=spread)
    cameras[3] = turned_by_a_degree(cameras[3], axis=2)
    check = judge_rig(cameras, found, UNKNOWN)
    assert [camera.camera for camera in check.cameras if camera.misplaced] == named


def test_two_cameras_may_be_turned() -> None:
    cameras = looking_in(np.arange(10) * 9.0, height=1.0)
    found = matches_of(cameras)
    for number in (2, 7):
        cameras[number] = turned_by_a_degree(cameras[number], 0)
    check = judge_rig(cameras, found, UNKNOWN)
    assert [camera.camera for camera in check.cameras if camera.misplaced] == ["cam02", "cam07"]


def test_neighbours_see_what_a_camera_sees_and_cameras_wide_apart_do_not() -> None:
    near = looking_in(ARC)
    check = judge_rig(near, matches_of(near), UNKNOWN)
    assert check.expected == RIGHT
    assert all(camera.seen_by_two > 0.7 for camera in check.cameras)
    # Cameras stand 9 degrees apart as seen from the middle of the points, which reach a third of the way to them.
    assert all(6 < camera.gap < 13 for camera in check.cameras)


def test_without_matches_nobody_knows_what_others_see() -> None:
    apart = looking_in([0.0, 90.0, 180.0, 270.0])
    check = judge_rig(apart, matches_of(apart), UNKNOWN)
    assert check.expected == WRONG
    assert all(math.isnan(camera.seen_by_one) for camera in check.cameras)
    assert all(line.split()[1:3] == ["-", "-"] for line in list(check.table())[-4:])
    (warning,) = check.warnings()
    assert warning.startswith("new views between the cameras will not look right: two other cameras see 0%")
    assert judge_rig(apart[:2], Matches(()), UNKNOWN).expected is None


@pytest.mark.parametrize(
    ("late", "said"),
    [
        ({}, []),
        ({2: 1.0}, ["camera cam02 appears 1 frame late"]),
        ({2: -6.5}, ["camera cam02 appears 6.5 frames early"]),
        ({1: 2.0, 3: -8.0}, ["camera cam01 appears 2 frames late", "camera cam03 appears 8 frames early"]),
    ],
)
def test_cameras_out_of_step_are_named(late: dict[int, float], said: list[str]) -> None:
    cameras = looking_in(ARC)
    found = np.array([late.get(number, 0.0) for number in range(len(cameras))])
    warnings = judge_rig(cameras, matches_of(cameras), found).warnings()
    assert [text.split(" against")[0] for text in warnings if "decogs-sync" in text] == said


@pytest.mark.parametrize(
    ("late", "step", "moments"),
    [
        ([0, 0, 0, 0], 1, []),
        ([0, 2, 0, -1], 1, [[1, 3, 1, 0], [3, 5, 3, 2], [5, 7, 5, 4]]),
        ([0, 8, 0, -4], 4, [[1, 3, 1, 0], [3, 5, 3, 2], [5, 7, 5, 4]]),  # of every fourth frame
        ([0, 6, 0, -7], 1, [[0, 6, 0, 0]]),  # no moment is in the pictures of all
    ],
)
def test_late_cameras_are_matched_by_the_pictures_of_the_others_moments(
    late: list[float], step: int, moments: list[list[int]]
) -> None:
    cameras, compared = looking_in(ARC[:4], height=1.0), []
    stats = SimpleNamespace(
        cameras=cameras, matches=matches_of(cameras), frames=range(10), step=step, pictures=[range(10)] * 4
    )

    def each(function: Callable, *given: Sequence) -> Iterator:
        if function is features_of:
            compared.append(list(given[1]))
            return iter([Features(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 128), np.float32))] * 4)
        return map(function, *given)

    _matches_in_place(stats, np.array(late, float), each)
    assert compared == moments
