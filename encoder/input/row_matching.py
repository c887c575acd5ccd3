"""Which Gaussian of one frame is which of the next, by their positions: each the other's nearest.

A grid has cells as wide as the search reaches; candidates are those of a cell and its 26 neighbours. The search is
exact, since results must not differ between machines.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]
_MAX_PAIRS = 1 << 22
"""Candidate pairs compared at once, which bounds the memory."""
_MAX_CELLS = 1 << 20
"""Along an axis; what lies beyond shares the outermost."""


def mutual_nearest(first: NDArray[np.float32], second: NDArray[np.float32], reach: float) -> tuple[Rows, Rows]:
    """Rows of ``first`` (N, 3), ascending, and of ``second`` (M, 3): each other's nearest within ``reach``."""
    if not len(first) or not len(second):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    low = np.minimum(first.min(axis=0), second.min(axis=0)).astype(np.float64)
    forth, back = _nearest(first, second, low, reach), _nearest(second, first, low, reach)
    rows = np.flatnonzero((forth >= 0) & (back[forth] == np.arange(len(first))))
    return rows, forth[rows]


def _nearest(points: NDArray[np.float32], among: NDArray[np.float32], low: NDArray[np.float64], reach: float) -> Rows:
    """Of each point, the row of the nearest ``among`` the others (the first of several), or -1."""
    keys = _keys(_cells(among, low, reach))
    order = np.argsort(keys, kind="stable")
    keys, cells = keys[order], _cells(points, low, reach)
    best, distance = np.full(len(points), -1, np.int64), np.full(len(points), float(reach) ** 2)
    for step in itertools.product((-1, 0, 1), repeat=3):
        wanted = _keys(cells + step)
        starts, stops = np.searchsorted(keys, wanted), np.searchsorted(keys, wanted, side="right")
        for chunk in _chunks(stops - starts):
            counts = stops[chunk] - starts[chunk]
            point = np.repeat(np.arange(len(points))[chunk], counts)
            offset = np.arange(len(point)) - np.repeat(np.cumsum(counts) - counts, counts)
            other = order[np.repeat(starts[chunk], counts) + offset]
            squares = ((points[point].astype(np.float64) - among[other]) ** 2).sum(axis=1)
            by_nearness = np.lexsort((other, squares, point))
            first = by_nearness[np.unique(point[by_nearness], return_index=True)[1]]
            nearer = squares[first] < distance[point[first]]
            chosen = first[nearer]
            best[point[chosen]], distance[point[chosen]] = other[chosen], squares[chosen]
    return best


def _cells(points: NDArray[np.float32], low: NDArray[np.float64], reach: float) -> Rows:
    return np.clip(np.floor((points - low) / reach), 0, _MAX_CELLS - 3).astype(np.int64) + 1


def _keys(cells: Rows) -> Rows:
    return np.asarray((cells[:, 0] * _MAX_CELLS + cells[:, 1]) * _MAX_CELLS + cells[:, 2], np.int64)


def _chunks(counts: Rows) -> list[slice]:
    """Slices of so many points that their candidates stay within bounds; a point's are never parted."""
    ends = (
        np.searchsorted(np.cumsum(counts), np.arange(_MAX_PAIRS, counts.sum() + _MAX_PAIRS, _MAX_PAIRS), side="left")
        + 1
    )
    edges = np.unique(np.clip(np.concatenate([[0], ends, [len(counts)]]), 0, len(counts)))
    return [slice(a, b) for a, b in itertools.pairwise(edges.tolist())]
