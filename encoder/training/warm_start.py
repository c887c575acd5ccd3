"""Where a Gaussian will probably go next: the last displacement of its neighbourhood.

A single Gaussian's displacement carries the noise of its own training, and a new Gaussian has none at all. Chosen: the
median over the nearest neighbours. Rejected: the Gaussian's own displacement (the noise walks on from frame to frame);
a rigid motion fitted to the neighbourhood, with or without its rotation (no better than the median on `workbench`,
whose car spins, at four times the cost).
"""

from __future__ import annotations

import cv2
import numpy as np

from decogs.formats.splats import FloatArray

_EXACT_KD_TREE: dict[str, bool | int | float | str] = {"algorithm": 4, "leaf_max_size": 10}
_ALL_LEAVES: dict[str, bool | int | float | str] = {"checks": -1}


def shared_displacements(means: FloatArray, displacements: FloatArray, neighbours: int) -> FloatArray:
    """The median displacement of every point's ``neighbours`` nearest, itself among them; all (M, 3), world units.

    1 neighbour leaves the displacements as they are.
    """
    count = min(neighbours, len(means))
    if count <= 1:
        return displacements
    tree = cv2.flann.Index(means, _EXACT_KD_TREE)
    nearest, _ = tree.knnSearch(means, count, params=_ALL_LEAVES)
    return np.asarray(np.median(displacements[nearest], axis=1), np.float32)
