"""Rotations: their matrices, also those of quaternions wxyz."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray


def is_orthonormal(matrix: NDArray[np.float64], tolerance: float) -> bool:
    """Whether a matrix (3, 3) is a rotation or reflection to within ``tolerance``."""
    # The largest entry first: products of hostile numbers stay far from overflow.
    return not (np.abs(matrix).max() > 2 or np.abs(matrix @ matrix.T - np.eye(3)).max() > tolerance)


def rotation_rows(w: Any, x: Any, y: Any, z: Any) -> list[list[Any]]:
    """Rows of the matrix of a unit quaternion, of numbers or of arrays of any kind."""
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def rotation_matrices(quaternions: Any, xp: ModuleType = np) -> Any:
    """Rotations (N, 3, 3) of quaternions (N, 4) of any norm, arrays of ``xp``; a zero one stands for no rotation."""
    norm = xp.sqrt((quaternions * quaternions).sum(-1))[:, None]
    identity = xp.zeros_like(quaternions)
    identity[:, 0] = 1.0
    unit = xp.where(norm > 1e-18, quaternions / xp.where(norm > 1e-18, norm, xp.ones_like(norm)), identity)
    rows = rotation_rows(unit[:, 0], unit[:, 1], unit[:, 2], unit[:, 3])
    return xp.stack([xp.stack(row, -1) for row in rows], -2)


def quaternion_of(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The unit quaternion wxyz (4,) of a rotation matrix (3, 3).

    Source: Bar-Itzhack 2000; the eigenvector of the largest eigenvalue, whatever the angle. Components that are 0
    up to rounding are exactly that, and so is a 1.
    """
    m = rotation
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    quaternion = np.round(np.linalg.eigh(k)[1][:, -1], 15)
    largest = quaternion[np.abs(quaternion).argmax()]
    return np.asarray(quaternion * np.sign(largest))


def quaternion_products(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotation ``first`` (4,) after each of ``second`` (N, 4), wxyz; norms multiply."""
    w, x, y, z = first
    of_second = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(second @ of_second.T)
