"""What goes on beside the pictures: where it lies, what it looks like from elsewhere, and how much there is of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.keyframe.border_extrapolation import border_extrapolation
from decogs.formats.cameras import Camera, in_picture, project
from decogs.formats.splats import Splats, round_splats
from decogs.rig.pictures.ingest import View

WALL = 4.0
"""Depth of a wall before two cameras beside each other."""
LEFT, RIGHT = np.array([0.8, 0.3, 0.1]), np.array([0.1, 0.4, 0.9])


def camera(x: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -x
    return Camera(f"at{x:g}", 120, 90, 110.0, 110.0, 60.0, 45.0, pose)


def wall() -> Splats:
    """A wall that is red on the left and blue on the right, no wider than the pictures together."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-2.7, 2.71, 0.06), np.arange(-1.65, 1.66, 0.06)))
    rgb = np.where(x[:, None] < 0, LEFT, RIGHT)
    return round_splats(
        np.stack([x, y, np.full_like(x, WALL)], -1), rgb, np.full(len(x), 0.04), np.full(len(x), 0.95), 1
    )


@pytest.fixture(scope="module")
def scene() -> tuple[list[View], list[np.ndarray], Splats]:
    kernel, cameras = CpuKernel(1), [camera(-0.5), camera(0.5)]
    pictures = [kernel.forward(wall(), each).rgb for each in cameras]
    return [View(each, each, None) for each in cameras], pictures, wall()


def beside(scene: tuple[list[View], list[np.ndarray], Splats], reach: float = 0.5, most: int = 2000) -> Splats:
    return border_extrapolation(CpuKernel(1), *scene, reach=reach, most=most)


def test_they_lie_on_the_wall_and_in_no_picture(scene: tuple[list[View], list[np.ndarray], Splats]) -> None:
    found = beside(scene)
    assert len(found) > 100
    np.testing.assert_allclose(found.means[:, 2], WALL, rtol=0.01)  # depths are means over a pixel's Gaussians
    for view in scene[0]:
        assert not in_picture(view.pinhole, *project(view.pinhole, found.means)).any()


def test_a_camera_that_looks_past_the_pictures_sees_the_wall_go_on_in_its_colours(
    scene: tuple[list[View], list[np.ndarray], Splats],
) -> None:
    found, kernel = beside(scene), CpuKernel(1)
    wide = replace(camera(0.0), width=200, cx=100.0)
    seen = kernel.forward(found, wide)
    strips = {"left": np.s_[:, 20:80, :12], "right": np.s_[:, 20:80, -12:]}
    for name, colour in (("left", LEFT), ("right", RIGHT)):
        strip = strips[name]
        assert seen.alpha[strip[1:]].min() > 0.8, "no gaps"
        assert kernel.forward(scene[2], wide).alpha[strip[1:]].mean() < 0.5, "there was nothing before"
        np.testing.assert_allclose(seen.rgb[strip].mean(axis=(1, 2)) / seen.alpha[strip[1:]].mean(), colour, atol=0.1)


@pytest.mark.parametrize("most", [0, 1, 30, 200])
def test_there_are_never_more_than_there_is_room_for(
    most: int, scene: tuple[list[View], list[np.ndarray], Splats]
) -> None:
    found = beside(scene, most=most)
    assert len(found) <= most
    assert len(found) > most / 4 or most < 30, "fewer are farther apart and larger"


def test_they_reach_as_far_as_asked_for(scene: tuple[list[View], list[np.ndarray], Splats]) -> None:
    extents = [np.ptp(beside(scene, reach).means[:, 0]) for reach in (0.1, 0.3, 0.5)]
    width = 120 / 110 * WALL
    cell = 6 / 96 * width  # the coarser ones; the last may be missing on either side
    np.testing.assert_allclose(extents, [1 + width * (1 + 2 * reach) for reach in (0.1, 0.3, 0.5)], atol=2 * cell)


def test_pixels_that_were_not_recorded_do_not_count(scene: tuple[list[View], list[np.ndarray], Splats]) -> None:
    views, pictures, splats = scene
    valid = np.ones((90, 120), np.float32)
    valid[:, :30] = 0
    views = [replace(view, valid=valid) for view in views]
    spoilt = [picture.copy() for picture in pictures]
    for picture in spoilt:
        picture[:, :, :30] = 1.0
    one, other = (
        border_extrapolation(CpuKernel(1), views, each, splats, reach=0.3, most=999) for each in (pictures, spoilt)
    )
    np.testing.assert_allclose(one.sh, other.sh, atol=1e-3)


def test_a_scene_that_shows_nothing_goes_on_as_nothing(scene: tuple[list[View], list[np.ndarray], Splats]) -> None:
    views, pictures, splats = scene
    hidden = replace(splats, opacity_logits=np.full_like(splats.opacity_logits, -9))
    assert len(border_extrapolation(CpuKernel(1), views, pictures, hidden, reach=0.5, most=999)) == 0
