"""Walls that are plain in most views: what views that do not see a point, or nothing of them, leave of it."""

from __future__ import annotations

import numpy as np

from decogs.formats.cameras import Camera
from decogs.rig.stage.room import pixels_beside, plain_points
from decogs.rig.stage.surfaces import PlainView

WIDTH, HEIGHT = 40, 20


def camera(across: float = 0.0) -> Camera:
    """Four units before the wall at z = 0, of which it sees 4 x 2."""
    pose = np.eye(4)
    pose[:3, 3] = [-across, 0, 4]
    return Camera("cam", WIDTH, HEIGHT, 40.0, 40.0, WIDTH / 2, HEIGHT / 2, pose)


def wall() -> tuple[np.ndarray, np.ndarray]:
    """Points 8 units wide and 2 high, a fifth of one apart, and normals to the cameras."""
    x, y = np.meshgrid(np.arange(-3.9, 4, 0.2), np.arange(-0.9, 1, 0.2))
    xyz = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return xyz, np.broadcast_to([0.0, 0.0, -1.0], xyz.shape)


def view(plain: float, across: float = 0.0) -> PlainView:
    """One whose picture is plain left of ``plain`` in the world."""
    own = camera(across)
    shown = np.zeros((HEIGHT, WIDTH), bool)
    shown[:, : int(own.cx + own.fx * (plain - across) / 4)] = True
    return PlainView(own, shown, np.zeros((HEIGHT, WIDTH, 3), np.float32))


def test_a_point_is_plain_where_more_than_a_third_of_its_views_show_it_so() -> None:
    xyz, normals = wall()
    seen = np.abs(xyz[:, 0]) < 2
    one_of_three = plain_points([view(1), view(-1), view(-1)], xyz, normals)
    np.testing.assert_array_equal(one_of_three[seen], xyz[seen, 0] < -1)
    two_of_three = plain_points([view(1), view(1), view(-1)], xyz, normals)
    np.testing.assert_array_equal(two_of_three[seen], xyz[seen, 0] < 1)


def test_points_that_no_view_shows_are_as_the_nearest_that_one_does() -> None:
    xyz, normals = wall()
    for across in (0.0, 1.0):
        np.testing.assert_array_equal(plain_points([view(0, across)], xyz, normals), xyz[:, 0] < 0)
    assert plain_points([view(0)], xyz, -normals).all(), "no view says anything else of what faces away"


def test_pixels_are_beside_the_wall_where_the_nearest_point_is_of_something_else() -> None:
    xyz, normals = wall()
    beside = pixels_beside(camera(), xyz, normals, xyz[:, 0] < 0)
    assert not beside[:, : WIDTH // 2].any()
    assert beside[:, WIDTH // 2 :].all()


def test_a_camera_that_sees_no_point_of_the_wall_sees_what_is_beside_it() -> None:
    xyz, normals = wall()
    assert pixels_beside(camera(20.0), xyz, normals, np.ones(len(xyz), bool)).all()
    assert pixels_beside(camera(), xyz, -normals, np.ones(len(xyz), bool)).all(), "its back"
