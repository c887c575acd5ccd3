"""A scene's values in the world, in double precision, for operations that judge them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header import StreamHeader
from decogs.codec.state import State


def positions(header: StreamHeader, state: State) -> NDArray[np.float64]:
    """Centres (N, 3) in world units."""
    lattice = header.lattice
    return np.asarray(state.means * np.asarray(lattice.means) + np.asarray(lattice.origin))
