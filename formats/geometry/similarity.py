"""A scene turned, scaled and shifted: positions, sizes, orientations, view-dependent colours and cameras together."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..splats import Splats
from .rotations import quaternion_of, quaternion_products
from .spherical_harmonics import sh_rotation


@dataclass(frozen=True)
class Similarity:
    """x becomes ``scale * rotation @ x + shift``: a rotation (3, 3), a positive factor, and a vector (3,)."""

    rotation: NDArray[np.float64]
    scale: float = 1.0
    shift: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))

    @property
    def is_identity(self) -> bool:
        """Whether nothing changes: neither size nor direction nor place."""
        return self.scale == 1 and np.array_equal(self.rotation, np.eye(3)) and not self.shift.any()

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The same as a matrix (4, 4) for column vectors."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.scale * self.rotation
        matrix[:3, 3] = self.shift
        return matrix

    @property
    def inverse(self) -> Similarity:
        """What takes everything back."""
        back = self.rotation.T / self.scale
        return Similarity(self.rotation.T, 1 / self.scale, -back @ self.shift)

    def after(self, first: Similarity) -> Similarity:
        """This one, done to what ``first`` has made."""
        shift = self.scale * self.rotation @ first.shift + self.shift
        return Similarity(self.rotation @ first.rotation, self.scale * first.scale, shift)


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
        moved = splats.means.astype(np.float64) @ (by.scale * by.rotation).T
        means = (moved + by.shift if by.shift.any() else moved).astype(np.float32)
    return Splats(
        means,
        (splats.log_scales + np.log(by.scale)).astype(np.float32),
        quaternion_products(quaternion_of(by.rotation), splats.quaternions.astype(np.float64)).astype(np.float32),
        splats.opacity_logits,
        np.einsum("jk,nkc->njc", coefficients, splats.sh.astype(np.float64)).astype(np.float32),
    )


def transformed_camera(camera: Camera, by: Similarity) -> Camera:
    """The camera where ``by`` brings it: it shows of the transformed scene what it showed of the scene."""
    pose = np.eye(4)
    pose[:3, :3] = camera.world_to_camera[:3, :3] @ by.rotation.T
    pose[:3, 3] = by.scale * camera.world_to_camera[:3, 3] - pose[:3, :3] @ by.shift
    return replace(camera, world_to_camera=pose, near=by.scale * camera.near)
