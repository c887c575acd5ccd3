"""Very wide pinholes are drawn as faces of a cube: what lies far off the axis shows where it is, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.decoder.rasterise import render
from decogs.decoder.rasterise.faces import faces_of
from decogs.decoder.rasterise.faces_view import FacesView, incremental_view
from decogs.decoder.rasterise.incremental_view import IncrementalView
from decogs.decoder.rasterise.native import MAX_PAIRS, render_planes
from decogs.formats.cameras import WIDEST_CORNER, Camera, is_wide, project
from decogs.formats.splats import Splats, round_splats, take_splats
from random_splats import random_splats

POSE = np.array([[0.6, 0, 0.8, 0.1], [0, 1, 0, -0.2], [-0.8, 0, 0.6, 0.3], [0, 0, 0, 1]])
WIDE = Camera("wide", 200, 150, 25.0, 26.0, 103.0, 71.0, POSE, near=0.01)
"""Its corners are 78 degrees off the axis."""


def blob(toward: tuple[float, float, float], sigma: float) -> Splats:
    """A white Gaussian in this direction of the camera, 2 units away."""
    place = 2 * np.array(toward) / np.linalg.norm(toward)
    world = POSE[:3, :3].T @ (place - POSE[:3, 3])
    return round_splats(world[None], np.ones((1, 3), np.float32), np.array([sigma]), np.array([0.9]), 0)


def test_only_pictures_with_far_corners_have_faces() -> None:
    edge = Camera("edge", 200, 200, 100 / WIDEST_CORNER * 2**0.5, 100 / WIDEST_CORNER * 2**0.5, 100.0, 100.0, np.eye(4))
    assert not is_wide(edge)
    assert not faces_of(edge)
    assert is_wide(replace(edge, cx=101.0))
    assert isinstance(incremental_view(edge, (0, 0, 0)), IncrementalView)
    assert not any(is_wide(face.camera) for face in faces_of(WIDE))


def test_every_pixel_is_of_one_face() -> None:
    count = np.zeros((WIDE.height, WIDE.width), int)
    for face in faces_of(WIDE):
        count[face.window] += face.own
    assert len(faces_of(WIDE)) == 5
    assert (count == 1).all()


def test_a_smooth_picture_comes_back_from_the_faces() -> None:
    row, column = np.mgrid[: WIDE.height, : WIDE.width]
    smooth = np.stack([np.sin(column / 40), np.cos(row / 40)], axis=-1).astype(np.float32)
    back = np.zeros_like(smooth)
    for face in faces_of(WIDE):
        face.put(face.of(smooth), back)
    # A face ahead has up to a twelfth of the wide picture's pixels at its border.
    assert np.abs(back - smooth).max() < 0.1
    assert np.abs(back - smooth).mean() < 0.005


@pytest.mark.parametrize(
    "toward", [(0, 0, 1), (3, 0.2, 1), (-3, -0.4, 1), (0.3, 2.2, 1), (-0.2, -2, 1), (0.97, 0.1, 1), (2.5, 2, 1)]
)
def test_what_is_small_shows_at_its_place(toward: tuple[float, float, float]) -> None:
    splats = blob(toward, 0.02)
    seen = render(splats, WIDE)
    u, v, depth = (value[0] for value in project(WIDE, splats.means))
    weight = seen.alpha / seen.alpha.sum()
    row, column = np.mgrid[: WIDE.height, : WIDE.width] + 0.5
    # Half a pixel of a face is up to eight of the wide picture's where it is stretched.
    stretch = 1 + toward[0] ** 2 + toward[1] ** 2
    assert abs((weight * column).sum() - u) < 0.3 * stretch
    assert abs((weight * row).sum() - v) < 0.3 * stretch
    assert seen.depth[np.unravel_index(seen.alpha.argmax(), seen.alpha.shape)] == pytest.approx(depth, rel=0.1)


def test_what_is_large_and_far_off_the_axis_is_no_veil() -> None:
    """75 degrees off, a sigma of .15 of its distance: the middle of the picture is nine of its sigmas away."""
    splats = blob((np.tan(np.radians(75)), 0, 1), 0.3)
    middle = (slice(66, 76), slice(98, 108))
    assert render(splats, WIDE).alpha[middle].max() < 1e-3
    whole = render_planes(splats, WIDE, (0, 0, 0), 1, MAX_PAIRS)[1]
    assert whole[middle].max() > 0.2, "as one affine image"


def test_a_played_wide_picture_is_the_rendered_one() -> None:
    scene = random_splats(400, 4, seed=3)
    view = incremental_view(WIDE, (0.1, 0.2, 0.3), threads=1)
    assert isinstance(view, FacesView)
    view.set_scene(scene)
    view.redraw()
    for name in ("image", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(view, name), getattr(render(scene, WIDE, (0.1, 0.2, 0.3)), name))
    rows = np.arange(5, 400, 7)
    moved = take_splats(scene, rows)
    moved = replace(moved, means=moved.means + np.float32(0.2))
    means = scene.means.copy()
    means[rows] = moved.means
    view.change(rows, moved, rows, population=400)
    assert view.redraw() > 0
    np.testing.assert_array_equal(view.image, render(replace(scene, means=means), WIDE, (0.1, 0.2, 0.3)).image)
    assert view.redraw() == 0
