"""The keyframe's weight of structure, by how many views see a surface.

The structural term of the loss (1 - SSIM) asks for the fine structure of each picture, its noise included. Where many
views see a surface, they agree on its structure only. Where two see it, training fits the noise of both, and a third
view shows needles. Chosen: a lower weight where first points were confirmed in few views. Rejected: a low weight
everywhere (cameras whose colours differ need the term, which ignores brightness). Figures: DESIGN.md.
"""

from __future__ import annotations

import numpy as np

from ..point_init import FirstPoints
from ..settings.keyframe import KeyframeSettings

_FEW, _MANY = 2.0, 5.0
"""Views per confirmed point, in the mean: of 360 degrees with nine cameras or a cage with seven, 2.3; of arcs and
domes, 5 to 10."""


def dissimilarity_for(points: FirstPoints, settings: KeyframeSettings) -> float:
    """Lambda of the keyframe's loss, between the settings' for few and for many views."""
    views = points.seen.sum(axis=0)
    confirmed = views[views > 0]
    mean = float(confirmed.mean()) if len(confirmed) else 0.0
    weights = [settings.few_views_dissimilarity, settings.dissimilarity]
    return float(np.interp(mean, [_FEW, _MANY], weights))
