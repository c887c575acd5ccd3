"""The state digest: a 64-bit fingerprint that costs what changed, not what there is (SPEC.md, "Digest").

A row hash is a multilinear form of the id and the integers of one Gaussian, scrambled. A state keeps its row hashes, so
that only rows that change or come are hashed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .state import ARRAYS, Attributes, Hashes, IntArray, Rows, State

MASK = (1 << 64) - 1
GOLDEN = 0x9E3779B97F4A7C15
_FIRST_FACTOR = 0xBF58476D1CE4E5B9
_SECOND_FACTOR = 0x94D049BB133111EB
_MAX_COLUMNS = 1 + 3 + 3 + 4 + 1 + 48


def mix(value: int) -> int:
    """The finaliser of splitmix64 on one integer."""
    value &= MASK
    value = ((value ^ (value >> 30)) * _FIRST_FACTOR) & MASK
    value = ((value ^ (value >> 27)) * _SECOND_FACTOR) & MASK
    return value ^ (value >> 31)


def _mix_array(values: Hashes) -> Hashes:
    mixed: Hashes = (values ^ (values >> np.uint64(30))) * np.uint64(_FIRST_FACTOR)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(_SECOND_FACTOR)
    mixed ^= mixed >> np.uint64(31)
    return mixed


def _column_keys() -> Hashes:
    return np.array([mix((j + 1) * GOLDEN) | 1 for j in range(_MAX_COLUMNS)], np.uint64)


_KEYS = _column_keys()
_FIRST_KEY = dict(zip(ARRAYS, (1, 4, 7, 11, 12), strict=True))


def row_hashes(attributes: Attributes, ids: Rows) -> Hashes:
    """The hash of each row, (n,), computed from nothing."""
    forms = ids.astype(np.uint64) * _KEYS[0]
    for name in ARRAYS:
        forms += _array_form(getattr(attributes, name), name)
    return _mix_array(forms)


def _array_form(values: IntArray, name: str) -> Hashes:
    """The share of one of ``ARRAYS`` in the rows' linear forms before scrambling, (n,)."""
    columns = values.reshape(len(values), math.prod(values.shape[1:]))
    start = _FIRST_KEY[name]
    # Signed integers: their sums and products modulo 2**64 have the same bits as the unsigned ones.
    keys = _KEYS[start : start + columns.shape[1]].view(np.int64)
    form: NDArray[np.int64] = np.einsum("nc,c->n", columns, keys)
    return form.view(np.uint64)


def combine(total: int, count: int, next_id: int) -> int:
    """Digest from the sum of the row hashes, the number of Gaussians and the next id."""
    return mix(mix(mix(total) + count) + next_id)


def digest(state: State) -> int:
    """The state's digest, from the hashes it keeps."""
    return combine(state.row_sum, len(state), state.next_id)
