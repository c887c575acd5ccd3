"""Prediction of a Gaussian's motion: the last displacement of its neighbourhood.

A single Gaussian's displacement contains the noise of its training, and a new Gaussian has none. Chosen: the median
over the nearest neighbours. Rejected: the Gaussian's own displacement (its noise accumulates over frames); a rigid
motion fitted to the neighbourhood, with or without rotation (no better than the median on `workbench`, whose car spins,
at four times the cost).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from decogs.formats.splats import FloatArray
from decogs.rig.numerics import nearest

_NEIGHBOUR_GAUSSIANS = 8
"""Nearest Gaussians whose median displacement is taken: one, its own, takes 8 % more bytes."""


def shared_displacements(
    means: FloatArray, displacements: FloatArray, neighbours: int = _NEIGHBOUR_GAUSSIANS
) -> FloatArray:
    """The median displacement of every point's ``neighbours`` nearest, itself among them; all (M, 3), world units.

    1 neighbour leaves the displacements as they are.
    """
    count = min(neighbours, len(means))
    if count <= 1:
        return displacements
    around, _ = nearest(means, count)
    return np.asarray(np.median(displacements[around], axis=1), np.float32)


@dataclass(frozen=True)
class Motion:
    """Velocity of every Gaussian: its ``last`` displacement (N, 3), world units; ``deferred`` frames since then."""

    last: FloatArray
    deferred: int = 0

    @classmethod
    def at_rest(cls, population: int) -> Motion:
        """Of a keyframe, whose Gaussians have no known motion."""
        return cls(np.zeros((population, 3), np.float32))

    def predict(self) -> FloatArray:
        """Predicted displacement up to the next frame, at constant velocity over deferred frames."""
        return np.asarray(self.last * np.float32(1 + self.deferred), np.float32)

    def defer(self, frames: int = 1) -> Motion:
        """After frames without training: the scene stays."""
        return Motion(self.last, self.deferred + frames)

    def move(self, displacements: FloatArray) -> Motion:
        """After these displacements since the last frame that was not deferred."""
        return Motion(displacements / np.float32(1 + self.deferred))
