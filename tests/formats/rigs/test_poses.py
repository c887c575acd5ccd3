"""Poses and projections: right, and the same on every processor."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np

from decogs.formats.cameras import turned
from decogs.formats.rigs.calibration import quaternion_pose, rigid_pose

BITS = """
import numpy as np
from decogs.formats.cameras import Camera, camera_centre, turned
from decogs.formats.rigs.calibration import invert_pose, rigid_pose
random = np.random.default_rng(5)
for _ in range(50):
    pose = np.hstack([np.linalg.qr(random.normal(size=(3, 3)))[0].round(4), random.normal(size=(3, 1))])
    pose[:, 0] *= np.sign(np.linalg.det(pose[:, :3]))
    rigid = rigid_pose(pose, "here")
    points = turned(rigid[:3, :3], random.normal(size=(9, 3)))
    centre = camera_centre(Camera("a", 4, 3, 5.0, 5.0, 2.0, 1.5, rigid))
    print(rigid.tobytes().hex(), invert_pose(rigid).tobytes().hex(), points.tobytes().hex(), centre.tobytes().hex())
"""


def near_rotations() -> list[np.ndarray]:
    """Rotations whose calibration file has four digits."""
    random = np.random.default_rng(3)
    orthogonal = [np.linalg.qr(random.normal(size=(3, 3)))[0] for _ in range(100)]
    return [(matrix * np.linalg.det(matrix)).round(4) for matrix in orthogonal]


def test_the_nearest_rotation_is_that_of_the_singular_value_decomposition() -> None:
    for matrix in near_rotations():
        rotation = rigid_pose(np.hstack([matrix, np.ones((3, 1))]), "here")[:3, :3]
        left, _, right = np.linalg.svd(matrix)
        # The decomposition itself is some twenty roundings (2^-53) off: 4e-15 measured.
        np.testing.assert_allclose(rotation, left @ right, rtol=0, atol=1e-14)
        # A handful of roundings of numbers near 1.
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=2e-15)


def test_a_quaternion_of_any_norm_is_its_rotation() -> None:
    """A third of a turn about the diagonal: x goes to y, y to z. Not all files have quaternions of norm 1."""
    for factor in (1.0, 0.02, -30.0):
        pose = quaternion_pose([0.5 * factor] * 4, [1, 2, 3], "here")
        np.testing.assert_allclose(pose[:3], [[0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3]], rtol=0, atol=2e-15)


def test_turned_is_the_product_with_the_matrix() -> None:
    random = np.random.default_rng(4)
    rotation, points = random.normal(size=(3, 3)), random.normal(size=(2, 7, 3))
    np.testing.assert_allclose(turned(rotation, points), points @ rotation.T, rtol=1e-12, atol=1e-14)
    assert turned(rotation, points[0, 0]).shape == (3,)


def test_poses_and_projections_have_the_same_bits_whatever_the_blas_takes() -> None:
    """Two of its processor types, one with fused multiply-add, and NumPy's plainest code."""
    plainest = {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"}
    assert bits({"OPENBLAS_CORETYPE": "Haswell"}) == bits(plainest)


def bits(environment: dict[str, str]) -> str:
    # NumPy warns of features to disable that the machine has not; that is no concern here.
    command = [sys.executable, "-W", "ignore", "-c", BITS]
    return subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=True).stdout
