"""The arrays of one frame, as trained and as exchanged: a scene of 3D Gaussians ("splats").

Stored and activated values never share a name. Stored: ``log_scales``, ``opacity_logits``, ``quaternions`` (any
non-zero norm) and ``sh``. Activated: ``scales = exp(log_scales)``, ``opacities = sigmoid(opacity_logits)``,
unit ``rotations`` and view-dependent ``rgb = 0.5 + SH(direction)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float32]
F = TypeVar("F", np.float32, np.float64)

SH_C0 = 0.28209479177387814
"""Value of the degree-0 spherical harmonic: display colour = 0.5 + SH_C0 * sh[:, 0]."""


@dataclass(frozen=True)
class Splats:
    """N Gaussians as stored values, float32, C-contiguous.

    Shapes: means (N, 3); log_scales (N, 3); quaternions (N, 4) wxyz; opacity_logits (N,);
    sh (N, K, 3) with K = (degree + 1)**2, degree 0 to 3, coefficients in 3DGS order.
    Units: means and exp(log_scales) in world units; colours display-referred (sRGB-coded) 0..1.
    """

    means: FloatArray
    log_scales: FloatArray
    quaternions: FloatArray
    opacity_logits: FloatArray
    sh: FloatArray

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return sh_degree_of(self.sh.shape[1])


def sigmoid(logits: NDArray[F]) -> NDArray[F]:
    """Logistic function; beyond +-80, where float32 would overflow, it stays as it is there."""
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -80, 80))), logits.dtype)


def logit(values: Any) -> Any:
    """Inverse of ``sigmoid``, the logarithm of the odds, of numbers or arrays strictly between 0 and 1."""
    return np.log(values / (1 - values))


def sh_degree_of(coefficients: int) -> int:
    """Spherical-harmonics degree that has this many coefficients per channel (1, 4, 9, 16)."""
    degree: int = round(float(coefficients) ** 0.5) - 1
    if (degree + 1) ** 2 != coefficients or not 0 <= degree <= 3:
        raise ValueError(f"{coefficients} SH coefficients per channel is no degree from 0 to 3")
    return degree


def empty_splats(sh_degree: int) -> Splats:
    """A scene without Gaussians."""
    k = (sh_degree + 1) ** 2
    return Splats(*(np.zeros(s, np.float32) for s in ((0, 3), (0, 3), (0, 4), (0,), (0, k, 3))))


def round_splats(
    xyz: NDArray[Any], rgb: NDArray[Any], sigmas: NDArray[Any], opacities: NDArray[Any], sh_degree: int
) -> Splats:
    """Round Gaussians of one colour from everywhere.

    ``xyz`` (N, 3) world; ``rgb`` (N, 3) 0 to 1, display-referred; ``sigmas`` (N,) world units; ``opacities`` (N,)
    between 0 and 1.
    """
    count = len(xyz)
    sh = np.zeros((count, (sh_degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (rgb - np.float32(0.5)) / np.float32(SH_C0)
    quaternions = np.zeros((count, 4), np.float32)
    quaternions[:, 0] = 1.0
    log_sigmas = np.log(np.maximum(sigmas, 1e-12)).astype(np.float32)
    return Splats(
        np.ascontiguousarray(xyz, np.float32),
        np.repeat(log_sigmas[:, None], 3, axis=1),
        quaternions,
        np.asarray(logit(opacities), np.float32),
        sh,
    )


def take_splats(splats: Splats, rows: NDArray[Any]) -> Splats:
    """The Gaussians at ``rows`` (indices or a boolean mask), in that order."""
    return Splats(
        splats.means[rows],
        splats.log_scales[rows],
        splats.quaternions[rows],
        splats.opacity_logits[rows],
        splats.sh[rows],
    )


def join_splats(first: Splats, second: Splats) -> Splats:
    """The Gaussians of ``first`` followed by those of ``second`` (same SH degree)."""
    return Splats(
        np.concatenate([first.means, second.means]),
        np.concatenate([first.log_scales, second.log_scales]),
        np.concatenate([first.quaternions, second.quaternions]),
        np.concatenate([first.opacity_logits, second.opacity_logits]),
        np.concatenate([first.sh, second.sh]),
    )
