"""A scene turned and scaled about its origin: positions, sizes, orientations and view-dependent colours together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .rotations import quaternion_of, quaternion_products
from .spherical_harmonics import sh_rotation
from .splats import Splats


@dataclass(frozen=True)
class Similarity:
    """x becomes ``scale * rotation @ x``: a rotation (3, 3) and a positive factor."""

    rotation: NDArray[np.float64]
    scale: float = 1.0

    @property
    def is_identity(self) -> bool:
        """Whether nothing changes: neither size nor direction."""
        return self.scale == 1 and np.array_equal(self.rotation, np.eye(3))

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The same as a matrix (4, 4) for column vectors."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        return matrix


NO_CHANGE = Similarity(np.eye(3))


def transformed_splats(splats: Splats, by: Similarity) -> Splats:
    """The splats where ``by`` brings them; the very object where it changes nothing.

    Computed in float64 and rounded once; what float32 cannot hold becomes infinite. Half a turn about an axis changes
    signs only, so that bits are kept.
    """
    if by.is_identity:
        return splats
    coefficients = sh_rotation(splats.sh_degree, by.rotation)
    with np.errstate(over="ignore"):
        means = (splats.means.astype(np.float64) @ (by.scale * by.rotation).T).astype(np.float32)
    return Splats(
        means,
        (splats.log_scales + np.log(by.scale)).astype(np.float32),
        quaternion_products(quaternion_of(by.rotation), splats.quaternions.astype(np.float64)).astype(np.float32),
        splats.opacity_logits,
        np.einsum("jk,nkc->njc", coefficients, splats.sh.astype(np.float64)).astype(np.float32),
    )
