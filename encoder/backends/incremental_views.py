"""The training views as they show the stream's scene, redrawn only where it changed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import Splats

from .protocol import FixedView


class IncrementalViews:
    """One fixed view for each training view, all of the scene static in it between frames.

    A dense method looks at none: it has no views here.
    """

    def __init__(self, views: Sequence[FixedView]) -> None:
        self.views = list(views)

    def show(self, scene: Splats) -> None:
        """Shows the whole scene, whatever was shown before."""
        for view in self.views:
            view.set_scene(scene)
            view.redraw()

    def detach(self, rows: NDArray[np.int64]) -> None:
        """Takes Gaussians out of the static part, as training does."""
        for view in self.views:
            view.detach(rows)

    def update(
        self, scene: Splats, trained: NDArray[np.int64], before: NDArray[np.int64], after: NDArray[np.int64]
    ) -> None:
        """Goes on from a frame's reconstructed ``scene``; only the rows ``trained`` (M,) of the frame before differ.

        ``before``, ``after``: the Gaussians' ids, ascending, in the frame before and in this one.
        """
        renumbered = np.searchsorted(after, before)
        renumbered[~np.isin(before, after, assume_unique=True)] = -1
        new = np.flatnonzero(~np.isin(after, before, assume_unique=True))
        rows = np.concatenate([np.setdiff1d(renumbered[trained], [-1]), new])
        for view in self.views:
            view.commit(scene, rows, renumbered)
            view.redraw()
