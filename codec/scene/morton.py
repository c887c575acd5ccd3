"""Morton order: Gaussians that are near in space are near in the stream (SPEC.md, "Morton order")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .state import IntArray, Rows

AXIS_BITS = 21
_SPREAD = (
    (32, 0x001F00000000FFFF),
    (16, 0x001F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
_GATHER = (
    (2, 0x10C30C30C30C30C3),
    (4, 0x100F00F00F00F00F),
    (8, 0x001F0000FF0000FF),
    (16, 0x001F00000000FFFF),
    (32, 0x00000000001FFFFF),
)

Codes = NDArray[np.uint64]


def morton_codes(means: IntArray, origin: NDArray[np.int64] | None = None) -> Codes:
    """Interleaved bits of the lattice positions (n, 3) above their minimum, x lowest; (n,) uint64.

    Spans beyond 21 bits on an axis are shifted right until they fit: an order still, but codes that cannot be undone.
    """
    if not len(means):
        return np.zeros(0, np.uint64)
    origin = means.min(axis=0).astype(np.int64) if origin is None else origin
    above = means.astype(np.int64) - origin
    shift = max(0, int(above.max()).bit_length() - AXIS_BITS)
    codes = np.zeros(len(means), np.uint64)
    for axis in range(3):
        codes |= _spread((above[:, axis] >> shift).astype(np.uint64)) << np.uint64(axis)
    return codes


def morton_order(means: IntArray) -> Rows:
    """Rows in Morton order, (n,) int64; rows of the same cell keep their order."""
    return np.argsort(morton_codes(means), kind="stable").astype(np.int64, copy=False)


def morton_positions(codes: Codes) -> NDArray[np.int64]:
    """Positions above the origin from codes below 2**63, (n, 3): the inverse of ``morton_codes``."""
    return np.stack([_gather(codes >> np.uint64(axis)) for axis in range(3)], axis=1).astype(np.int64)


def _spread(values: Codes) -> Codes:
    for shift, mask in _SPREAD:
        values = (values | (values << np.uint64(shift))) & np.uint64(mask)
    return values


def _gather(values: Codes) -> Codes:
    values = values & np.uint64(_SPREAD[-1][1])
    for shift, mask in _GATHER:
        values = (values | (values >> np.uint64(shift))) & np.uint64(mask)
    return values
