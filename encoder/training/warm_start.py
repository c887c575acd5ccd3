"""Where a Gaussian will probably go next: the last displacement of its neighbourhood.

A single Gaussian's displacement carries the noise of its own training, and a new Gaussian has none at all. Chosen: the
median over the nearest neighbours. Rejected: the Gaussian's own displacement (the noise walks on from frame to frame);
a rigid motion fitted to the neighbourhood, with or without its rotation (no better than the median on `workbench`,
whose car spins, at four times the cost).
"""

from __future__ import annotations

import numpy as np

from decogs.formats.splats import FloatArray

from ..numerics import nearest


def shared_displacements(means: FloatArray, displacements: FloatArray, neighbours: int) -> FloatArray:
    """The median displacement of every point's ``neighbours`` nearest, itself among them; all (M, 3), world units.

    1 neighbour leaves the displacements as they are.
    """
    count = min(neighbours, len(means))
    if count <= 1:
        return displacements
    around, _ = nearest(means, count)
    return np.asarray(np.median(displacements[around], axis=1), np.float32)


class Motion:
    """How far every Gaussian moved in the last frame; ``last`` (N, 3), world units."""

    def __init__(self) -> None:
        self.last: FloatArray = np.zeros((0, 3), np.float32)
        self._held = 0

    def begin(self, population: int) -> None:
        """Of the keyframe's Gaussians nothing is known."""
        self.last = np.zeros((population, 3), np.float32)

    def expected(self) -> FloatArray:
        """The displacement up to the next frame: what was held is taken to have moved on."""
        return np.asarray(self.last * np.float32(1 + self._held), np.float32)

    def hold(self) -> None:
        """The frame waits for time; the scene stays as it is."""
        self._held += 1

    def moved(self, displacements: FloatArray) -> None:
        """Takes those since the last frame that was not held."""
        self.last = displacements / np.float32(1 + self._held)
        self._held = 0
