"""Worlds that are turned, scaled and shifted: what cameras and Gaussians show stays what it was."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera, project
from decogs.formats.geometry.similarity import NO_CHANGE, Similarity, transformed_camera, transformed_splats
from decogs.formats.splats import Splats

TURN = cv2.Rodrigues(np.array([0.3, -0.8, 0.5]))[0]
BY = Similarity(TURN, 2.5, np.array([1.0, -2.0, 0.5]))
POINTS = np.random.default_rng(2).uniform(-1, 1, (50, 3))


def moved(points: np.ndarray) -> np.ndarray:
    return np.asarray(BY.scale * points @ BY.rotation.T + BY.shift)


def camera() -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(np.array([0.1, 0.2, -0.1]))[0], [0.1, 0.2, 4.0]
    return Camera("one", 64, 48, 60.0, 60.0, 32.0, 24.0, pose, near=0.5)


def test_a_camera_shows_of_the_moved_scene_what_it_showed_of_the_scene() -> None:
    """Depths and the near plane are in the new unit."""
    before, after = project(camera(), POINTS), project(transformed_camera(camera(), BY), moved(POINTS))
    for one, other, scale in zip(before, after, (1, 1, BY.scale), strict=True):
        np.testing.assert_allclose(scale * one, other, atol=1e-9)
    assert transformed_camera(camera(), BY).near == pytest.approx(0.5 * BY.scale)


def test_what_is_taken_there_comes_back() -> None:
    for both in (BY.inverse.after(BY), BY.after(BY.inverse)):
        np.testing.assert_allclose(both.matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(BY.after(BY).matrix, BY.matrix @ BY.matrix, atol=1e-12)


def test_gaussians_are_moved_turned_and_scaled_and_stay_where_nothing_changes() -> None:
    random = np.random.default_rng(3)
    splats = Splats(*(random.normal(size=(50, *shape)).astype(np.float32) for shape in ((3,), (3,), (4,), (), (4, 3))))
    splats = replace(splats, means=POINTS.astype(np.float32))
    assert transformed_splats(splats, NO_CHANGE) is splats
    there = transformed_splats(splats, BY)
    np.testing.assert_allclose(there.means, moved(splats.means.astype(np.float64)), rtol=1e-6)  # float32
    np.testing.assert_allclose(there.log_scales - splats.log_scales, np.log(2.5), atol=1e-6)
    np.testing.assert_array_equal(there.opacity_logits, splats.opacity_logits)
    back = transformed_splats(there, BY.inverse)
    for name in ("means", "log_scales", "sh"):
        np.testing.assert_allclose(getattr(back, name), getattr(splats, name), atol=1e-5)  # rounded twice
