"""Orbit and spiral: around what the rig looks at, upright, and no farther than its cameras saw."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.decoder.cameras.moves import camera_move, looked_at, looking
from decogs.decoder.cameras.path import CameraPath, ToFilm
from decogs.formats.cameras import Camera, camera_centre, project
from decogs.formats.errors import UsageError
from decogs.formats.geometry.up_direction import up_of

TARGET, UP = np.array([0.3, -0.2, 1.0]), np.array([0.0, 0.0, 1.0])


def rig(degrees: list[float], radius: float = 2.0, height: float = 0.5) -> tuple[Camera, ...]:
    """Cameras on an arc about the target, at these angles from -y."""
    cameras = []
    for k, angle in enumerate(np.radians(degrees)):
        place = TARGET + radius * np.array([np.sin(angle), -np.cos(angle), 0]) + height * UP
        cameras.append(Camera(f"c{k}", 64, 48, 60.0, 60.0, 32.0, 24.0, looking(place, TARGET, UP)))
    return tuple(cameras)


def angles(path: CameraPath) -> np.ndarray:
    out = np.array([camera_centre(camera) for camera in path.cameras]) - TARGET
    return np.degrees(np.arctan2(out[:, 0], -out[:, 1]))


ARC = rig([-40, -20, 0, 20, 40])
RING = rig(list(range(0, 360, 30)))


@pytest.mark.parametrize("cameras", [ARC, RING])
def test_the_rigs_point_and_up_are_found(cameras: tuple[Camera, ...]) -> None:
    np.testing.assert_allclose(looked_at(cameras), TARGET, atol=1e-9)
    np.testing.assert_allclose(up_of(cameras), UP, atol=1e-9)


def test_parallel_cameras_look_at_a_point_before_them() -> None:
    cameras = tuple(
        Camera(f"c{k}", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4) + np.array([[0, 0, 0, -k], *[[0] * 4] * 3]))
        for k in range(3)
    )
    np.testing.assert_allclose(looked_at(cameras), [1, 0, 2])
    np.testing.assert_allclose(up_of(cameras), [0, -1, 0])


@pytest.mark.parametrize("move", ["orbit", "spiral"])
@pytest.mark.parametrize("cameras", [ARC, RING])
def test_a_move_looks_at_the_point_and_stands_upright(move: str, cameras: tuple[Camera, ...]) -> None:
    path = camera_move(move, ToFilm(cameras, 10.0, 60))  # type: ignore[arg-type]
    assert path.times == tuple(range(60))
    for camera in path.cameras:
        u, v, depth = project(camera, TARGET[None])
        assert (u[0], v[0]) == pytest.approx((32, 24))
        assert depth[0] > 0
        assert (camera.world_to_camera[:3, :3] @ UP)[1] < 1e-12  # 0 where a ring's spiral looks straight down
        np.testing.assert_allclose(np.linalg.det(camera.world_to_camera), 1)


def test_an_orbit_goes_as_far_as_the_rig() -> None:
    swung = angles(camera_move("orbit", ToFilm(ARC, 30.0, 200)))
    assert (swung.min(), swung.max()) == (pytest.approx(-40, abs=1.5), pytest.approx(40, abs=1.5))
    round_trip = np.unwrap(np.radians(angles(camera_move("orbit", ToFilm(RING, 30.0, 200)))))
    assert abs(round_trip[-1] - round_trip[0]) == pytest.approx(2 * np.pi * 199 / 200)


def test_a_spiral_stays_within_the_rig() -> None:
    centres = np.array([camera_centre(camera) for camera in ARC])
    places = np.array([camera_centre(camera) for camera in camera_move("spiral", ToFilm(ARC, 30.0, 200)).cameras])
    far = np.abs(places - centres.mean(axis=0)).max(axis=0)
    assert 0 < far[0] < np.abs(centres - centres.mean(axis=0)).max(axis=0)[0]
    away = np.linalg.norm(places - centres.mean(axis=0), axis=1)
    assert away[0] == pytest.approx(0, abs=1e-12), "it begins in the rig's middle"
    assert away[-1] < away[100] / 20, "and comes back there"


def test_short_streams_play_to_and_fro() -> None:
    assert camera_move("orbit", ToFilm(ARC, 2.0, 3)).times == (0, 1, 2, 1, 0, 1, 2, 1)
    assert camera_move("orbit", ToFilm(ARC, 1.0, 1)).times == (0, 0, 0, 0)


def test_a_rig_of_one_place_has_no_moves() -> None:
    with pytest.raises(UsageError, match="`move` orbit: needs a rig"):
        camera_move("orbit", ToFilm(ARC[:1], 30.0, 5))


def test_looking_straight_down_is_possible() -> None:
    camera = looking(TARGET + UP, TARGET, UP)
    assert np.isfinite(camera).all()
    np.testing.assert_allclose(camera[:3, :3] @ camera[:3, :3].T, np.eye(3), atol=1e-12)
