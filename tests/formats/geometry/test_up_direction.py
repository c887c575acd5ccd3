"""Which way is up: what cameras tell of worlds whose up is known, and the turn from one direction to another."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.geometry.rotations import quaternion_of, rotation_rows
from decogs.formats.geometry.up_direction import AXES, UPS, turn_between, up_of, up_text, up_vector


def looking(position: np.ndarray, at: np.ndarray, up: np.ndarray, roll: float = 0.0) -> Camera:
    """A camera of OpenCV's axes whose horizon is level, but for ``roll`` in degrees."""
    forward = (at - position) / np.linalg.norm(at - position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
    pose = np.eye(4)
    pose[:3, :3] = [c * right + s * down, c * down - s * right, forward]
    pose[:3, 3] = -pose[:3, :3] @ position
    return Camera("c", 64, 48, 50.0, 50.0, 32.0, 24.0, pose)


def an_arc(turn: np.ndarray, *, rolls: tuple[float, ...] = (0.0,) * 9) -> list[Camera]:
    """Nine cameras on an arc of 80 degrees around the origin, in a world with Z up, all looking down by 27 degrees."""
    angles = np.radians(np.linspace(-40, 40, len(rolls)))
    places = [np.array([4 * np.sin(a), -4 * np.cos(a), 2.0]) for a in angles]
    return [
        looking(turn @ place, np.zeros(3), turn @ AXES["Z"], roll) for place, roll in zip(places, rolls, strict=True)
    ]


def a_turn(seed: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


@pytest.mark.parametrize("seed", range(8))
def test_cameras_that_look_down_from_one_side_tell_the_up_of_a_turned_world(seed: int) -> None:
    turn = a_turn(seed)
    mean = np.mean([-camera.world_to_camera[1, :3] for camera in an_arc(turn)], axis=0)
    assert angle(mean / np.linalg.norm(mean), turn @ AXES["Z"]) > 10, "the mean leans"
    # Unless it is within 5 degrees of an axis, which none of these is, it is exact.
    assert angle(up_of(an_arc(turn)), turn @ AXES["Z"]) < 1e-4


@pytest.mark.parametrize("name", list(AXES))
def test_a_world_that_is_level_but_for_a_few_degrees_has_an_axis(name: str) -> None:
    turn = turn_between(AXES["Z"], AXES[name])
    cameras = an_arc(turn, rolls=(1, -2, 0.5, 0, 2, -1, 1, 0, -1.5))
    np.testing.assert_array_equal(up_of(cameras), AXES[name])
    assert up_text(up_of(cameras)) == name


def test_cameras_side_by_side_have_their_mean_up() -> None:
    """All x axes are equal: nothing but the mean says how far they look down."""
    cameras = [looking(np.array([x, -4, 0.5]), np.array([x, 0, 0]), AXES["Z"]) for x in (-1.0, 0.0, 1.0)]
    down = np.degrees(np.arctan2(0.5, 4))
    assert angle(up_of(cameras), AXES["Z"]) == pytest.approx(down)
    np.testing.assert_allclose(up_of(cameras[:1]), up_of(cameras), atol=1e-12)


def test_cameras_that_roll_have_their_mean_up() -> None:
    rolls = (30.0, -30, 25, -25, 0, 28, -28, 20, -20)
    cameras = an_arc(a_turn(1), rolls=rolls)
    mean = np.mean([-camera.world_to_camera[1, :3] for camera in cameras], axis=0)
    assert angle(up_of(cameras), mean / np.linalg.norm(mean)) < 1e-4


def test_cameras_that_roll_near_an_axis_have_that() -> None:
    rolls = (25.0, -20, 20, -20, 0, 20, -20, 20, -10)
    places = [camera.world_to_camera for camera in an_arc(np.eye(3))]
    places = [-(pose[:3, :3].T @ pose[:3, 3]) * [1, 1, 0.4] for pose in places]
    cameras = [looking(place, np.zeros(3), AXES["Z"], roll) for place, roll in zip(places, rolls, strict=True)]
    mean = np.mean([-camera.world_to_camera[1, :3] for camera in cameras], axis=0)
    assert 5 < angle(mean / np.linalg.norm(mean), AXES["Z"]) < 15
    np.testing.assert_array_equal(up_of(cameras), AXES["Z"])


def test_cameras_that_do_not_tell_are_taken_for_colmaps() -> None:
    one = looking(np.array([0.0, -4, 0]), np.zeros(3), AXES["Z"])
    other = looking(np.array([0.0, -4, 0]), np.zeros(3), AXES["-Z"])
    for cameras in ([], [one, other]):
        np.testing.assert_array_equal(up_of(cameras), AXES["-Y"])


def test_choices() -> None:
    cameras = an_arc(np.eye(3))
    assert up_vector("none", cameras) is None
    np.testing.assert_array_equal(up_vector("auto", cameras), AXES["Z"])
    for name in set(UPS) - {"auto", "none"}:
        np.testing.assert_array_equal(up_vector(name, cameras), AXES[name])
    assert up_text(np.array([0.6, -0.8, 0.0])) == "(0.60, -0.80, 0.00)"


@pytest.mark.parametrize("to", ["Y", "-Y"])
@pytest.mark.parametrize("seed", range(6))
def test_the_turn_takes_one_to_the_other_by_the_smallest_angle(to: str, seed: int) -> None:
    ups = [*AXES.values(), a_turn(seed)[0]]
    for up in ups:
        turn = turn_between(up, AXES[to])
        np.testing.assert_allclose(turn @ up, AXES[to], atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)
        assert np.trace(turn) == pytest.approx(1 + 2 * (up @ AXES[to]), abs=1e-9)
        np.testing.assert_allclose(np.array(rotation_rows(*quaternion_of(turn))), turn, atol=1e-12)


def test_colmaps_world_turns_as_opencvs_axes_do_into_opengls() -> None:
    np.testing.assert_array_equal(turn_between(AXES["-Y"], AXES["Y"]), np.diag([1.0, -1, -1]))
    np.testing.assert_array_equal(turn_between(AXES["-Y"], AXES["-Y"]), np.eye(3))
