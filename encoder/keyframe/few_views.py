"""The keyframe's weight of structure, by how many views see a surface.

The structural term of the loss (1 - SSIM) asks for the fine structure of each picture, its noise included. Where many
views see a surface, they agree on its structure only. Where two see it, training fits the noise of both, and a third
view shows needles. Chosen: a lower weight where first points were confirmed in few views. Rejected: a low weight
everywhere (cameras whose colours differ need the term, which ignores brightness). Figures: DESIGN.md.
"""

from __future__ import annotations

import numpy as np

from .first_points import FirstPoints

DISSIMILARITY = 0.2
"""Lambda of 3DGS's loss, where many views see a surface."""
_FEW_VIEWS, _MANY_VIEWS = 2.0, 5.0
"""Views per confirmed point, in the mean: of 360 degrees with nine cameras or a cage with seven, 2.3; of arcs and
domes, 5 to 10."""


def dissimilarity_for(points: FirstPoints, few_views_dissimilarity: float) -> float:
    """Lambda of the keyframe's loss, between that for few and that for many views."""
    views = points.seen.sum(axis=0)
    confirmed = views[views > 0]
    mean = float(confirmed.mean()) if len(confirmed) else 0.0
    return float(np.interp(mean, [_FEW_VIEWS, _MANY_VIEWS], [few_views_dissimilarity, DISSIMILARITY]))
