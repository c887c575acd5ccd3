"""Poses and projections: right, and the same on every processor."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from decogs.formats.cameras import Camera, turned
from decogs.formats.errors import RigError
from decogs.formats.rigs.calibration import calibrated_camera, quaternion_pose, rigid_pose

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


def pose(*, scale: float = 1.0, last: tuple[float, ...] = (0, 0, 0, 1), shift: float = 0.0) -> np.ndarray:
    matrix = np.diag([scale, 1.0, 1.0, 1.0])
    matrix[0, 3], matrix[3] = shift, last
    return matrix


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.eye(3), "no 3 x 4 or 4 x 4 matrix"),
        (pose(scale=1.0006), "scaled or skewed axes"),
        (pose(shift=1.1e12), "not a rigid motion"),
        (pose(last=(0, 0, 0, 1.1)), "not a rigid motion"),
        (pose(last=(0, 2e-6, 0, 1)), "not a rigid motion"),
        (pose(scale=0.0), "singular"),
        (pose(scale=-1.0), "mirrored"),
        (pose(scale=np.nan), "NaN"),
    ],
)
def test_a_pose_that_no_camera_has(matrix: np.ndarray, message: str) -> None:
    with pytest.raises(RigError, match=f"^here: the pose is .*{message}|^here: the pose holds {message}"):
        rigid_pose(matrix, "here")


@pytest.mark.parametrize("matrix", [pose(scale=1.0004), pose(shift=-1e12), pose(last=(0, 9e-7, 0, 1))])
def test_what_a_file_rounds_is_rigid(matrix: np.ndarray) -> None:
    rigid = rigid_pose(matrix, "here")
    np.testing.assert_allclose(rigid[:3, :3], np.eye(3), rtol=0, atol=1e-15)
    assert rigid[3].tolist() == [0, 0, 0, 1]


def camera(fx: float = 60.0, fy: float = 60.0, cx: float = 32.0, cy: float = 24.0, k1: float = 0.0) -> Camera:
    return calibrated_camera("a", (64, 48), (fx, fy, cx, cy), np.eye(4), "opencv", (k1, 0.0, 0.0, 0.0), "here")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": 1e7}, "focal lengths 1e"),
        ({"fy": 1e7}, "focal lengths 60, 1e"),
        ({"fy": 0.0}, "focal lengths 60, 0 "),
        ({"cx": np.nan}, "NaN"),
        ({"k1": np.inf}, "NaN or infinite"),
        ({"cx": 673.0}, "far off the picture"),
        ({"cy": -617.0}, "far off the picture"),
    ],
)
def test_a_lens_that_no_camera_has(changes: dict[str, float], message: str) -> None:
    with pytest.raises(RigError, match=message):
        camera(**changes)


def test_a_principal_point_may_lie_ten_pictures_off() -> None:
    assert (camera(cx=672.0).cx, camera(cy=-616.0).cy) == (672.0, -616.0)
    assert (camera().distortion_model, camera(k1=0.1).distortion_model) == ("none", "opencv")


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
