"""Spherical harmonics in 3DGS's order and signs: their values, and their coefficients in a scene that was turned."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DIRECTIONS = 64
_DIGITS = 13
"""Decimals to which a turn's coefficients are known: what should be 0, 1/2 or 1 then is that exactly."""


def sh_basis(xp: ModuleType, degree: int, directions: Any) -> Any:
    """Spherical-harmonics basis (N, (degree+1)**2) of unit directions (N, 3), in 3DGS's order and signs."""
    x, y, z = directions[:, 0], directions[:, 1], directions[:, 2]
    xx, yy, zz = x * x, y * y, z * z
    basis = [
        0.28209479177387814 * xp.ones_like(x),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return xp.stack(basis[: (degree + 1) ** 2], -1)


def sh_rotation(degree: int, rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix (K, K) that turns SH coefficients (K, ...) as ``rotation`` (3, 3) turns the scene.

    A turned scene shows in a direction d what the scene shows in the direction R^T d. The harmonics of one degree turn
    among themselves (Wigner's D matrices), so that each degree's block is the solution of that equation in more
    directions than it has coefficients.
    """
    directions = np.random.default_rng(0).normal(size=(_DIRECTIONS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    basis, turned_basis = sh_basis(np, degree, directions), sh_basis(np, degree, directions @ rotation)
    turned = np.zeros(((degree + 1) ** 2,) * 2)
    for band in range(degree + 1):
        block = slice(band**2, (band + 1) ** 2)
        turned[block, block] = np.linalg.lstsq(basis[:, block], turned_basis[:, block], rcond=None)[0]
    return np.round(turned, _DIGITS)
