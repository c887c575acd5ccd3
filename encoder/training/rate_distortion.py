"""Rate-distortion optimised quantisation: of the integers near a trained value, the one of least cost.

The distortion of a number is the squared change of a picture's loss, its rate what an entropy coder with a table per
channel takes. Source: entropy-constrained scalar quantisation (Chou, Lookabaugh and Gray 1989), with a weight for each
number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.state import IntArray
from decogs.formats.splats import FloatArray

_TABLE_ROUNDS = 4
"""Iterations of choosing values and updating the table of their bits; more change next to nothing."""
_MAX_CANDIDATES = 256
"""Candidates of a channel: all values that rotations and colours have on a lattice, a bound for any others."""
_MAX_CHANGE_CANDIDATES = 16
"""The same of changes, nearly all of which are smaller than ten steps."""
_PARTS_OF_BIT = 2.0**20
"""Parts of a bit: on this grid, the last bit of a logarithm, which differs by machine, is lost."""

Doubles = NDArray[np.float64]


def cheapest(values: FloatArray, change: FloatArray, bit: float) -> IntArray:
    """Integers near ``values`` (N, C), in lattice steps, by rate-distortion optimisation.

    ``change`` (N, C): change of the loss per step. Candidates of a number are its nearest integer and the commonest of
    its channel. The choice minimises the squared change of the loss plus ``bit`` times its bits; ``bit`` 0 gives the
    nearest.
    """
    chosen = np.rint(values).astype(np.int32)
    if bit and len(values):
        for channel, column in enumerate(values.T):
            chosen[:, channel] = _cheapest(column, chosen[:, channel], change[:, channel], bit, _MAX_CANDIDATES)
    return chosen


def cheapest_changes(changes: Doubles, loss: Doubles, bit: float) -> Doubles:
    """Whole ``changes`` (N, C) of lattice points, most of which are none, by rate-distortion optimisation.

    ``loss`` (N, C): change of the loss per step. As `cheapest`, but that what is nearest to no change stays none.
    """
    chosen = np.rint(changes)
    if bit and len(changes):
        for channel, column in enumerate(changes.T):
            rows = np.flatnonzero(chosen[:, channel])
            given = column[rows], chosen[rows, channel], loss[rows, channel]
            chosen[rows, channel] = _cheapest(*given, bit, _MAX_CHANGE_CANDIDATES, zeros=len(chosen) - len(rows))
    return chosen


def _cheapest(
    values: NDArray[Any], nearest: NDArray[Any], change: NDArray[Any], bit: float, most: int, *, zeros: int = 0
) -> NDArray[Any]:
    """One channel's (N,) integers, coded with so many ``zeros`` more; candidates: ``most`` of the commonest."""
    chosen = nearest
    for _ in range(_TABLE_ROUNDS):
        table, table_rows, counts = np.unique(np.append(chosen, 0), return_inverse=True, return_counts=True)
        counts[table_rows[-1]] += zeros - 1  # The 0 that was appended is none of them; the table may still need one.
        bits = np.rint(_PARTS_OF_BIT * np.log2((len(chosen) + zeros) / np.maximum(counts, 1))) / _PARTS_OF_BIT
        best, least = chosen, (change * (chosen - values)) ** 2 + bit * bits[table_rows[:-1]]
        for table_row in np.argsort(-counts, kind="stable")[:most]:
            cost = (change * (table[table_row] - values)) ** 2 + bit * bits[table_row]
            best = np.where(cost < least, table[table_row], best)
            least = np.minimum(cost, least)
        chosen = best
    return chosen
