"""What moves in a stream that grows: half of it is in the base.

What will move is not known when the base is trained, and those few that stand for a still thing no longer look like it
once all of it moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.lattice import Lattice, dequantise
from decogs.codec.scene.state import Rows, State, take_rows
from decogs.formats.splats import Splats, sigmoid

from .rounds import Round, grown

_SHARE = 0.5
"""Of those that move, and of those that come: with .4 of them, a car of a few hundred Gaussians had holes."""
_GROWTH = 0.15
"""Of logarithmic sizes, by which this half covers what all did."""


@dataclass(frozen=True, eq=False)
class _Places:
    """Where Gaussians (N,) were first: ``centres`` (N, 3), and how large they were, ``sizes`` (N,) in world units."""

    ids: Rows
    centres: NDArray[np.float64]
    sizes: NDArray[np.float64]

    def of(self, here: NDArray[np.bool_]) -> _Places:
        return _Places(self.ids[here], self.centres[here], self.sizes[here])


class Movers:
    """Who moves in a stream whose ``first`` scene has this ``lattice``."""

    def __init__(self, first: State, lattice: Lattice) -> None:
        self._lattice = lattice
        self._standing = self._places(first, first.ids)

    def joined(self, base: Round, before: State, state: State) -> Round:
        """The ``base`` with half of those that have now moved by more than their size, and of those that are new since
        the state ``before``: its own first, then those that cover most.

        All of them are but larger than in the whole scene, whatever they were trained to be while they stood still.
        """
        new = np.setdiff1d(state.ids, before.ids, assume_unique=True)
        moved = self._moved(state, new)
        own = np.isin(moved, base.ids, assume_unique=True)
        joining = self._most_covering(state, moved[~own], round(_SHARE * len(moved)) - int(own.sum()))
        coming = self._most_covering(state, new, round(_SHARE * len(new)))
        ids = np.sort(np.concatenate([moved[own], joining, coming]))
        return base.updated(state, ids, grown(len(ids), state.coefficients, _GROWTH, self._lattice))

    def _moved(self, state: State, new: Rows) -> Rows:
        """The ids of those that stood where they were first, up to this state; ``new`` ones stand from now on."""
        was = self._standing.of(np.isin(self._standing.ids, state.ids, assume_unique=True))
        now = self._places(state, was.ids)
        moved = np.linalg.norm(now.centres - was.centres, axis=1) > was.sizes
        left, come = was.of(~moved), self._places(state, new)
        both = (np.concatenate([getattr(left, name), getattr(come, name)]) for name in ("ids", "centres", "sizes"))
        self._standing = _Places(*both)
        return np.asarray(was.ids[moved])

    def _places(self, state: State, ids: Rows) -> _Places:
        splats = self._splats(state, ids)
        sizes = np.exp(splats.log_scales.astype(np.float64)).max(axis=1, initial=0.0)
        return _Places(ids, splats.means.astype(np.float64), sizes)

    def _most_covering(self, state: State, ids: Rows, count: int) -> Rows:
        """So many of these, by opacity and the area that they cover."""
        splats = self._splats(state, ids)
        sizes: NDArray[np.float64] = np.sort(splats.log_scales.astype(np.float64), axis=1)[:, 1:]
        covered = sigmoid(splats.opacity_logits.astype(np.float64)) * np.exp(sizes.sum(1))
        return ids[np.argsort(-covered, kind="stable")[: max(count, 0)]]

    def _splats(self, state: State, ids: Rows) -> Splats:
        return dequantise(take_rows(state, np.searchsorted(state.ids, ids)), self._lattice)
