"""Gaussians for what the views agree on and a keyframe under training does not show: things that no first point met."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.formats.splats import FloatArray, Splats, empty_splats
from decogs.rig.pictures.ingest import View

from ..backends import Optimiser, TrainingKernel
from ..settings.frame import EmergenceSettings
from ..training.seeding import SearchView, find_seeds, missed_pixels

_SEARCH = EmergenceSettings()
_MIN_SHARE = 3e-3
"""Of the scene's Gaussians, how many are something: where nothing is missed, chance finds up to half of that."""


def missed_surfaces(
    kernel: TrainingKernel, scene: Optimiser, views: Sequence[View], pictures: Sequence[FloatArray]
) -> Splats:
    """New Gaussians for surfaces of the ``scene`` that four or more views miss; mostly none.

    ``pictures`` (3, H, W) of the ``views``. See `training.seeding`, which finds what emerges in later frames.
    """
    searched = []
    for view, picture in zip(views, pictures, strict=True):
        drawn = kernel.forward(scene, view.pinhole, depth=True)
        assert drawn.depth is not None
        recorded = np.ones(picture.shape[1:], bool) if view.recorded is None else view.recorded
        rgb, alpha, depth = (np.array(plane) for plane in (drawn.rgb, drawn.alpha, drawn.depth))
        searched.append(SearchView(view.pinhole, picture, rgb, alpha, depth, recorded, view.recorded))
    degree = scene.splats.sh_degree
    found = find_seeds(searched, [missed_pixels(view) for view in searched], _SEARCH, degree)
    return found if len(found) >= _MIN_SHARE * len(scene) else empty_splats(degree)
