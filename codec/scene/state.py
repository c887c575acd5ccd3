"""The decoder's state: every Gaussian as integers on the lattice (SPEC.md, "State").

Arrays of a State are read-only and may be shared between successive states: a delta copies only what it changes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import sh_degree_of

IntArray = NDArray[np.int32]
Rows = NDArray[np.int64]
Hashes = NDArray[np.uint64]
Integers = NDArray[np.signedinteger[Any]]
"""int32 or, where they are small, narrower."""

GROUPS = ("means", "log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
"""The attribute groups in wire order; bit g of a presence byte stands for GROUPS[g]."""

ARRAYS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
"""The arrays that hold the groups, in the same order; ``sh`` holds the last two."""

DEFAULT_MAX_GAUSSIANS = 1 << 21
"""What a reader accepts by default; bounds the memory a hostile stream can claim (SPEC.md, "Limits")."""

MAX_GAUSSIANS = 1 << 27
"""What the format allows."""

MAX_ID = (1 << 63) - 1

NARROW = 1 << 14
"""Magnitude up to which a state's integers are int16; a residual of one byte may be added to them as they are."""

_Attributes = TypeVar("_Attributes", bound="Attributes")


@dataclass(frozen=True, eq=False)
class Attributes:
    """N Gaussians as lattice integers, int32 (less perhaps in a State), C-contiguous; shapes as in Splats."""

    means: IntArray
    log_scales: IntArray
    quaternions: IntArray
    opacity_logits: IntArray
    sh: IntArray

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def coefficients(self) -> int:
        """SH coefficients per colour channel, (degree + 1)**2."""
        return int(self.sh.shape[1])


@dataclass(frozen=True, eq=False)
class State(Attributes):
    """The scene after a frame. Rows are ordered by strictly increasing ``ids`` (int64), which no later Gaussian reuses.

    An array whose integers are small (NARROW) may be int16, which halves what a delta has to copy: compute with what
    ``all_rows`` and ``take_rows`` give, which is int32.

    ``hashes`` (uint64) has the rows' hashes, from which the digest comes; ``next_id`` is the id of the next Gaussian to
    appear, ``frame`` the frame's index. Build one with ``new_state``: ``hashes`` must fit the other arrays.
    """

    ids: Rows
    hashes: Hashes
    next_id: int
    frame: int

    @property
    def row_sum(self) -> int:
        """The sum of the row hashes modulo 2**64."""
        return int(self.hashes.sum(dtype=np.uint64))


def group_channels(coefficients: int) -> dict[str, int]:
    """Number of channels of each attribute group; sh_rest has none at degree 0."""
    return dict(zip(GROUPS, (3, 3, 4, 1, 3, 3 * (coefficients - 1)), strict=True))


def group_columns(attributes: Attributes, group: str) -> IntArray:
    """One attribute group as a view (N, channels); sh_rest runs over coefficients, then colours."""
    return array_columns(getattr(attributes, array_of(group)), group)


def array_columns(values: IntArray, group: str) -> IntArray:
    """One attribute group as a view (n, channels) of rows (n, ...) of the array that holds it, C-contiguous."""
    columns = values.reshape(len(values), math.prod(values.shape[1:]))
    if group == "sh_dc":
        return columns[:, :3]
    return columns[:, 3:] if group == "sh_rest" else columns


def array_of(group: str) -> str:
    """The name of the array that holds an attribute group."""
    return "sh" if group.startswith("sh_") else group


def attributes_from_columns(columns: Mapping[str, Integers], count: int, coefficients: int) -> Attributes:
    """Attributes from (count, channels) arrays per group; a group that is absent is zero."""
    widths = group_channels(coefficients)
    full = {g: columns[g] if g in columns else np.zeros((count, widths[g]), np.int32) for g in GROUPS}
    sh = np.empty((count, coefficients, 3), np.int32)
    sh[:, 0] = full["sh_dc"]
    sh[:, 1:] = full["sh_rest"].reshape(count, coefficients - 1, 3)
    return Attributes(
        np.ascontiguousarray(full["means"], np.int32),
        np.ascontiguousarray(full["log_scales"], np.int32),
        np.ascontiguousarray(full["quaternions"], np.int32),
        np.ascontiguousarray(full["opacity_logits"][:, 0], np.int32),
        sh,
    )


def empty_attributes(coefficients: int) -> Attributes:
    """No Gaussians at all."""
    return attributes_from_columns({}, 0, coefficients)


def take_rows(attributes: Attributes, rows: NDArray[Any]) -> Attributes:
    """The Gaussians at the indices ``rows``, in that order, int32, without their ids."""
    # ndarray.take is several times faster than indexing here.
    return Attributes(*(getattr(attributes, name).take(rows, axis=0).astype(np.int32, copy=False) for name in ARRAYS))


def part_of(state: State, rows: NDArray[Any]) -> State:
    """The Gaussians at ``rows`` (rising indices or a boolean mask) as a state of their own, with their ids."""
    arrays = {name: read_only(getattr(state, name)[rows]) for name in ARRAYS}
    return State(**arrays, ids=state.ids[rows], hashes=state.hashes[rows], next_id=state.next_id, frame=state.frame)


def all_rows(attributes: Attributes) -> Attributes:
    """All the Gaussians, int32, without their ids."""
    return Attributes(*(getattr(attributes, name).astype(np.int32, copy=False) for name in ARRAYS))


def narrowed(values: Integers) -> Integers:
    """The same integers as a state holds them: int16 if all are within NARROW, else int32."""
    if values.min(initial=0) < -NARROW or values.max(initial=0) > NARROW:
        return values.astype(np.int32, copy=False)
    return values.astype(np.int16, copy=False)


def join_rows(first: Attributes, second: Attributes) -> Attributes:
    """The Gaussians of both, ``second``'s behind ``first``'s, without their ids."""
    return Attributes(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in ARRAYS))


def same_scene(first: State, second: State) -> bool:
    """Whether two states are one scene at two times: they share every array, and nothing was compared."""
    return all(getattr(first, name) is getattr(second, name) for name in (*ARRAYS, "ids"))


def same_values(first: State, second: State) -> bool:
    """Whether two states have the same Gaussians: ids and values are equal, number for number."""
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("ids", *ARRAYS))


def changed_between(first: State, second: State) -> NDArray[np.bool_]:
    """Which of the ``first`` state's Gaussians are gone in the ``second`` or have other values there, (N,)."""
    _, first_rows, second_rows = np.intersect1d(first.ids, second.ids, assume_unique=True, return_indices=True)
    changed = np.ones(len(first), bool)
    changed[first_rows] = False
    for name in ARRAYS:
        differs = getattr(first, name)[first_rows] != getattr(second, name)[second_rows]
        changed[first_rows] |= differs.reshape(len(first_rows), math.prod(differs.shape[1:])).any(axis=1)
    return changed


def check_shapes(attributes: Attributes) -> None:
    """Raises ValueError unless the arrays are int32 of one length and of the shapes of Splats."""
    n, k = len(attributes), attributes.coefficients
    sh_degree_of(k)
    shapes = {"means": (n, 3), "log_scales": (n, 3), "quaternions": (n, 4), "opacity_logits": (n,), "sh": (n, k, 3)}
    for name, shape in shapes.items():
        array = getattr(attributes, name)
        if array.shape != shape or array.dtype != np.int32:
            raise ValueError(f"{name} is {array.dtype} {array.shape}, not int32 {shape}")


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """The same array behind a view that cannot be written."""
    view: NDArray[Any] = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view
