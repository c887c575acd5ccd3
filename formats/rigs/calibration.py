"""Checks that every calibration goes through: a rigid pose, sane intrinsics; and OpenCV's way to write both."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..cameras import MAX_SIDE, Camera, DistortionModel, as_pinhole, is_distorted, turned
from ..errors import RigError
from ..geometry.rotations import is_orthonormal, rotation_rows

_RIGID_TOLERANCE = 1e-3
"""How far R R^T may be from the identity: calibration files carry as few as 4 digits."""

_LEAST_SKEW = 1e-6
"""As a share of the focal length: a hundredth of a pixel in a picture of 8000."""


def rigid_pose(matrix: ArrayLike, where: str) -> NDArray[np.float64]:
    """The (4, 4) pose with its rotation made exactly orthonormal (nearest in the Frobenius sense).

    Takes (3, 4) or (4, 4). Raises RigError, starting with ``where``, if it is NaN, singular, scaled or mirrored.
    """
    pose = np.asarray(matrix, np.float64)
    if pose.shape not in ((3, 4), (4, 4)):
        raise RigError(f"{where}: the pose is no 3 x 4 or 4 x 4 matrix; calibrate the camera again")
    if not np.isfinite(pose).all():
        raise RigError(f"{where}: the pose holds NaN or infinite values; calibrate the camera again")
    rotation, translation = pose[:3, :3], pose[:3, 3]
    if not is_orthonormal(rotation, _RIGID_TOLERANCE):
        singular = np.abs(rotation).max() <= 2 and abs(np.linalg.det(rotation)) < _RIGID_TOLERANCE
        what = "singular" if singular else "not a rigid motion (scaled or skewed axes)"
        raise RigError(f"{where}: the pose is {what}; calibrate the camera again")
    if np.linalg.det(rotation) < 0:
        raise RigError(f"{where}: the pose is mirrored (left-handed axes); export it in a right-handed convention")
    if np.abs(translation).max() > 1e12 or (pose.shape == (4, 4) and np.abs(pose[3] - (0, 0, 0, 1)).max() > 1e-6):
        raise RigError(f"{where}: the pose is not a rigid motion; calibrate the camera again")
    rigid = np.eye(4)
    rigid[:3, :3] = _nearest_rotation(rotation)
    rigid[:3, 3] = translation
    return rigid


def _nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """The orthonormal factor of a matrix that is nearly a rotation.

    Newton's iteration for the polar decomposition (Higham 1986): the mean of the matrix and its transposed inverse. The
    error is squared each time, from 1e-3 to nothing in four. By sums in a fixed order: LAPACK's last bits depend on the
    processor, and poses are written into streams.
    """
    for _ in range(4):
        x, y, z = matrix
        cofactors = np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)])
        matrix = (matrix + cofactors / (x * cofactors[0]).sum()) / 2
    return matrix


def invert_pose(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """World-to-camera from camera-to-world, or back; (4, 4), rigid."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = -turned(pose[:3, :3].T, pose[:3, 3])
    return inverse


def vector_pose(rotation: ArrayLike, translation: ArrayLike, where: str) -> NDArray[np.float64]:
    """The pose (4, 4) of a rotation vector (3,), its angle in radians, or matrix (3, 3), and a translation (3,).

    Raises RigError, starting with ``where``, as ``rigid_pose`` does, and for another number of values.
    """
    turn, shift = (np.asarray(values, np.float64).ravel() for values in (rotation, translation))
    if turn.size not in (3, 9) or shift.size != 3:
        raise RigError(f"{where}: the pose has {turn.size} and {shift.size} values, not 3 or 9 and 3; correct the file")
    matrix = turn.reshape(3, 3) if turn.size == 9 else _turn_about(turn)
    return rigid_pose(np.hstack([matrix, shift[:, None]]), where)


def _turn_about(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    import cv2

    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def quaternion_pose(quaternion: Sequence[float], translation: ArrayLike, where: str) -> NDArray[np.float64]:
    """The pose (4, 4) of a quaternion (w, x, y, z), of any norm, and a translation (3,). Raises as ``rigid_pose``."""
    q = np.array(quaternion, np.float64)
    norm = float(np.linalg.norm(q)) if np.isfinite(q).all() and np.abs(q).max() < 1e100 else 0.0
    if norm < 1e-6:
        raise RigError(f"{where}: the pose is singular (rotation quaternion {tuple(quaternion)}); export it again")
    return vector_pose(rotation_rows(*(q / norm)), translation, where)


FIRST_PIXEL_AT_0 = 0.5
"""To add to a principal point that counts from the centre of the first pixel, as OpenCV's calibration does."""


def opencv_camera(
    name: str,
    size: tuple[int, int],
    matrix: ArrayLike,
    distortion: ArrayLike,
    world_to_camera: NDArray[np.float64],
    where: str,
    *,
    shift: float = FIRST_PIXEL_AT_0,
    is_fisheye: bool = False,
) -> Camera:
    """A camera as OpenCV describes it: camera matrix (3, 3), and 4, 5, 8, 12 or 14 coefficients, a fisheye's 4.

    Zeros after the coefficients that a Camera has are dropped. ``shift`` is added to the principal point. Raises
    RigError, starting with ``where``, also for a skewed matrix and for a lens of thin prisms or a tilted sensor.
    """
    numbers = np.asarray(matrix, np.float64).ravel()
    if numbers.size != 9:
        raise RigError(f"{where}: the camera matrix has {numbers.size} values, not 9; correct the file")
    fx, skew, cx, zero, fy, cy, *last = (float(number) for number in numbers)
    if not (abs(skew) <= _LEAST_SKEW * abs(fx) and zero == 0 and last == [0, 0, 1]):
        raise RigError(f"{where}: the camera matrix is not [fx 0 cx; 0 fy cy; 0 0 1]; calibrate without skew")
    coefficients = tuple(float(number) for number in np.asarray(distortion, np.float64).ravel())
    kept = 4 if is_fisheye else 8
    if any(coefficients[kept:]) or len(coefficients) not in ((0, 4) if is_fisheye else (0, 4, 5, 8, 12, 14)):
        lens = "a fisheye has 4" if is_fisheye else "only k1 k2 p1 p2 k3 k4 k5 k6 are read"
        raise RigError(f"{where}: {len(coefficients)} distortion coefficients, but {lens}; undistort the pictures")
    model: DistortionModel = "fisheye" if is_fisheye else "opencv"
    intrinsics = (fx, fy, cx + shift, cy + shift)
    return calibrated_camera(name, size, intrinsics, world_to_camera, model, coefficients[:kept], where)


def calibrated_camera(
    name: str,
    size: tuple[int, int],
    intrinsics: tuple[float, float, float, float],
    world_to_camera: NDArray[np.float64],
    distortion_model: DistortionModel,
    distortion: tuple[float, ...],
    where: str,
) -> Camera:
    """A camera with its intrinsics (fx, fy, cx, cy in pixels) checked; a model that bends nothing is dropped.

    Raises RigError, starting with ``where``, on values no camera has.
    """
    width, height = size
    fx, fy, cx, cy = intrinsics
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise RigError(f"{where}: {width} x {height} pixels is no usable size; correct the calibration")
    if not all(math.isfinite(value) for value in (*intrinsics, *distortion)):
        raise RigError(f"{where}: the intrinsics hold NaN or infinite values; calibrate the camera again")
    if not (0 < fx < 1e7 and 0 < fy < 1e7):
        raise RigError(f"{where}: focal lengths {fx:g}, {fy:g} are not usable; calibrate the camera again")
    if max(abs(cx - width / 2), abs(cy - height / 2)) > 10 * max(width, height):
        raise RigError(f"{where}: principal point {cx:g}, {cy:g} is far off the picture; calibrate the camera again")
    camera = Camera(name, width, height, fx, fy, cx, cy, world_to_camera, distortion_model, distortion)
    return camera if is_distorted(camera) else as_pinhole(camera)
