"""How far a keyframe's colours depend on the direction they are seen from: gloss, mirrors, sheen.

The keyframe is trained with the preset's spherical harmonics, and rounding (`keyframe/train.py`) keeps the visible
ones: on three synthetic rigs 2 to 3 of a thousand Gaussians keep any, on a recorded dome 119. Below ``MIN_SH_SHARE``
the stream has none, and later frames train none.

Rejected: comparing points that two cameras share, before training (slanted surfaces differ as much as gloss does: 11
levels on a matte wall, 9.2 on a matte rendering of `workbench`, 9.4 on the same with its gloss; no rig was ever
found without); a second training without harmonics, to compare the tiles left out of the loss (twice the time, and two
trainings differ by more than that by chance).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.codec.scene.state import Attributes
from decogs.formats.splats import sh_degree_of

MIN_SH_SHARE = 0.01
"""Least share of a keyframe's Gaussians with harmonics of a degree or above for the stream to have that degree."""


def trim_sh_degree(values: Attributes) -> Attributes:
    """A keyframe's rounded ``values`` without the SH degrees that hardly any Gaussian uses."""
    degree = sh_degree_of(values.coefficients)
    while degree and values.sh[:, degree**2 :].any(axis=(1, 2)).sum() < MIN_SH_SHARE * len(values):
        degree -= 1
    return replace(values, sh=np.ascontiguousarray(values.sh[:, : (degree + 1) ** 2]))
