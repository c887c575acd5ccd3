"""What all layers share: the sRGB curve, the logistic function, rotations, projection."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera, in_camera, in_picture, project, ray_slopes
from decogs.formats.colours.srgb import linear_from_srgb, srgb_from_linear
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.splats import logit, sigmoid


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_srgb_both_ways(kind: type[np.float32]) -> None:
    """Expected values from IEC 61966-2-1: the linear toe and mid grey 0.5 -> 0.21404114."""
    coded = np.array([0.0, 0.04, 0.5, 1.0], kind)
    np.testing.assert_allclose(linear_from_srgb(coded), [0, 0.04 / 12.92, 0.21404114, 1], rtol=1e-6)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(coded)), coded, atol=2e-7)
    assert linear_from_srgb(coded).dtype == srgb_from_linear(coded).dtype == kind


def test_the_sigmoid_does_not_overflow_and_the_logit_undoes_it() -> None:
    logits = np.array([-500, -2, 0, 2, 500], np.float32)
    expected = [0, 1 / (1 + np.exp(2)), 0.5, 1 / (1 + np.exp(-2)), 1]
    assert sigmoid(logits) == pytest.approx(np.array(expected), abs=1e-7)
    assert logit(sigmoid(logits[1:4])) == pytest.approx(logits[1:4], abs=1e-6)


def test_a_quaternion_of_any_norm_turns_about_its_axis_and_a_zero_one_does_not() -> None:
    half = 0.35
    quaternions = np.array([[np.cos(half), *(np.sin(half) * np.array([0.6, 0, 0.8]))], [0, 0, 0, 0]])
    matrices = rotation_matrices(quaternions * 3)
    np.testing.assert_allclose(matrices[0], cv2.Rodrigues(2 * half * np.array([0.6, 0, 0.8]))[0], atol=1e-15)
    np.testing.assert_array_equal(matrices[1], np.eye(3))


def test_a_point_is_projected_onto_the_pixel_whose_ray_it_is_on() -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(np.array([0.1, -0.2, 0.3]))[0], (0.5, -1.0, 2.0)
    camera = Camera("one", 64, 48, 50.0, 60.0, 30.0, 25.0, pose)
    points = np.array([[0.1, 0.2, 3.0], [9.0, 0.2, 3.0], [0.0, 0.0, -9.0]])
    u, v, depth = project(camera, points)
    assert in_picture(camera, u, v, depth).tolist() == [True, False, False]
    x, y = ray_slopes(camera, u, v)
    np.testing.assert_allclose(in_camera(camera, points), np.stack([x, y, np.ones(3)], axis=1) * depth[:, None])
