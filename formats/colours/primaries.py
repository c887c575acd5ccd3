"""Primaries and white of linear RGB, and the way from one set to another.

Source: OpenEXR's technical introduction and ImfChromaticities; Bradford's matrix as in its ImfAcesFile.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
"""x and y of red, green, blue and white: Rec. 709's, which are sRGB's and what an EXR has that states none."""

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_SAME = 1e-3
"""x and y of primaries are stated with three or four digits."""


def to_rec709(chromaticities: tuple[float, ...]) -> F64 | None:
    """(3, 3): linear RGB of these primaries and white into Rec. 709's, white to white; None where they are the same.

    Raises ValueError for chromaticities that span no colours.
    """
    if np.allclose(chromaticities, REC709, rtol=0, atol=_SAME):
        return None
    ours, our_white = _to_xyz(REC709)
    theirs, white = _to_xyz(chromaticities)
    cones = (_BRADFORD @ our_white) / (_BRADFORD @ white)
    adapted = np.linalg.inv(_BRADFORD) @ np.diag(cones) @ _BRADFORD
    return np.asarray(np.linalg.inv(ours) @ adapted @ theirs)


def _to_xyz(chromaticities: tuple[float, ...]) -> tuple[F64, F64]:
    """The matrix (3, 3) to CIE XYZ, and the white (3,), of luminance 1."""
    x, y = np.asarray(chromaticities, np.float64).reshape(4, 2).T
    if not (np.isfinite(x) & np.isfinite(y) & (np.abs(x) < 10) & (np.abs(y) < 10)).all() or y[3] < 1e-3:
        raise ValueError
    columns = np.stack([x, y, 1 - x - y])
    primaries, white = columns[:, :3], columns[:, 3] / y[3]
    # White is a mixture of the primaries, with something of each.
    if abs(np.linalg.det(primaries)) < 1e-4:
        raise ValueError
    amounts = np.linalg.solve(primaries, white)
    if amounts.min() < 1e-3 or (_BRADFORD @ white).min() < 1e-3:
        raise ValueError
    return primaries * amounts, white
