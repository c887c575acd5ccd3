"""A scene's values in the world, in double precision, for operations that judge them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.state import State
from decogs.formats.cameras import turned


def positions(header: StreamHeader, state: State) -> NDArray[np.float64]:
    """Centres (N, 3) in the world in which the stream is shown."""
    lattice, transform = header.lattice, header.presentation.similarity
    stored = state.means * np.asarray(lattice.means) + np.asarray(lattice.origin)
    return transform.scale * turned(transform.rotation, stored) + transform.shift
