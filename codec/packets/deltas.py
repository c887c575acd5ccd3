"""Deltas: what changes from one frame's state to the next (SPEC.md, "Applying a delta").

Residuals go to existing rows first, then rows are removed, then new Gaussians are appended. Rows that are in none of
these are bit-identical before and after.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.digest import row_hashes
from ..scene.morton import morton_order
from ..scene.state import (
    ARRAYS,
    GROUPS,
    MAX_ID,
    Attributes,
    IntArray,
    Integers,
    Rows,
    State,
    array_columns,
    array_of,
    check_shapes,
    empty_attributes,
    group_channels,
    group_columns,
    narrowed,
    read_only,
    take_rows,
)

_ARRAYS = (*ARRAYS, "ids", "hashes")


@dataclass(frozen=True)
class Changes:
    """Numbers of Gaussians: existing ones whose values changed, new ones, and ones that went."""

    touched: int
    added: int
    removed: int


@dataclass(frozen=True, eq=False)
class Delta:
    """The change of one frame.

    ``rows`` (n,) int64, strictly increasing: the touched rows of the previous state; ``residuals`` maps an attribute
    group to what is added modulo 2**32, (n, channels), groups that do not change being absent; ``removed`` (r,)
    int64, strictly increasing: rows of the previous state that go; ``added``: the Gaussians that come, in stream order.
    """

    rows: Rows
    residuals: Mapping[str, Integers]
    removed: Rows
    added: Attributes

    @property
    def changes(self) -> Changes:
        """How many Gaussians it changes, adds and removes."""
        return Changes(len(self.rows), len(self.added), len(self.removed))


def difference(
    previous: State,
    rows: NDArray[Any],
    current: Attributes,
    *,
    removed: NDArray[Any] | None = None,
    added: Attributes | None = None,
) -> Delta:
    """The smallest delta that takes ``rows`` of ``previous`` to the values ``current`` holds for them.

    ``rows`` are indices in any order, each at most once, as are ``removed``; rows whose integers do not change are left
    out, as are rows that are removed. ``added`` is put in Morton order (a stable sort: what is in that order stays).
    Raises ValueError when rows, lengths or shapes do not fit.
    """
    touched = _checked_rows(rows, len(previous))
    gone = _checked_rows(np.zeros(0, np.int64) if removed is None else removed, len(previous))
    added = empty_attributes(previous.coefficients) if added is None else added
    for attributes in (current, added):
        check_shapes(attributes)
        if attributes.coefficients != previous.coefficients:
            raise ValueError("the SH degree changes inside a stream")
    if len(current) != len(touched):
        raise ValueError(f"{len(touched)} rows but values for {len(current)}")
    order = np.argsort(touched, kind="stable")
    order = order[~np.isin(touched[order], gone)]
    changes = _residuals(take_rows(previous, touched[order]), take_rows(current, order))
    moved = np.zeros(len(order), bool)
    for residual in changes.values():
        moved |= residual.any(axis=1)
    return Delta(
        touched[order][moved],
        {group: residual[moved] for group, residual in changes.items()},
        np.sort(gone),
        take_rows(added, morton_order(added.means)),
    )


def apply_delta(previous: State, delta: Delta) -> State:
    """The next frame's state. Arrays that do not change are shared with ``previous``; its arrays are never written.

    The indices of ``delta`` must be valid (``difference`` and the payload reader see to it).
    """
    stays = np.ones(len(previous), bool)
    stays[delta.removed] = False
    rows, residuals = _rows_that_stay(delta, stays)
    moved = _moved_rows(previous, rows, residuals)
    arrays = _resized(previous, delta, stays)
    kept_rows = rows_after(delta.removed, rows)
    for name, values in moved.items():
        dtype = np.promote_types(arrays[name].dtype, values.dtype)
        if arrays[name] is getattr(previous, name) or arrays[name].dtype != dtype:
            arrays[name] = arrays[name].astype(dtype)
        _as_items(arrays[name])[kept_rows] = _as_items(values.astype(dtype, copy=False))
    frozen = {name: read_only(array) for name, array in arrays.items()}
    return State(**frozen, next_id=previous.next_id + len(delta.added), frame=previous.frame + 1)


def rows_after(removed: Rows, rows: Rows) -> Rows:
    """Where rows that stay are once those of ``removed`` (ascending) are gone."""
    # A row moves up by the number of removed rows before it.
    return rows - np.searchsorted(removed, rows) if len(removed) else rows


def ids_left(previous: State) -> int:
    """How many Gaussians may still be added before the ids run out."""
    return MAX_ID - previous.next_id


def _rows_that_stay(delta: Delta, stays: NDArray[np.bool_]) -> tuple[Rows, Mapping[str, Integers]]:
    """Touched rows and their residuals without those of rows that are removed anyway."""
    kept = stays.take(delta.rows)
    if kept.all():
        return delta.rows, delta.residuals
    return delta.rows[kept], {group: residual[kept] for group, residual in delta.residuals.items()}


def _moved_rows(previous: State, rows: Rows, residuals: Mapping[str, Integers]) -> dict[str, NDArray[Any]]:
    """The touched rows as they are afterwards, of the arrays that change."""
    if not len(rows) or not residuals:
        return {}
    moved = {name: getattr(previous, name).take(rows, axis=0) for name in ARRAYS}
    for group, residual in residuals.items():
        name = array_of(group)
        # What one byte can add, int16 has room for (NARROW).
        if residual.dtype != np.int8:
            moved[name] = moved[name].astype(np.int32, copy=False)
        columns = array_columns(moved[name], group)
        columns += residual
    hashes = row_hashes(Attributes(**moved), previous.ids.take(rows))
    changed = {array_of(group) for group in residuals}
    return {**{name: narrowed(moved[name]) for name in changed}, "hashes": hashes}


def _as_items(array: NDArray[Any]) -> NDArray[Any]:
    """A C-contiguous array's rows as one item each, (n,), which numpy moves in one go."""
    return array.reshape(-1).view(np.dtype((np.void, array.itemsize * math.prod(array.shape[1:]))))


def _resized(previous: State, delta: Delta, stays: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """The state's arrays without the removed and with the added rows; the very same arrays when there are neither."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(previous, name) for name in _ARRAYS}
    if not len(delta.removed) and not len(delta.added):
        return arrays
    keep = np.flatnonzero(stays)
    ids = previous.next_id + np.arange(len(delta.added))
    coming: dict[str, NDArray[Any]] = {name: narrowed(getattr(delta.added, name)) for name in ARRAYS}
    coming |= {"ids": ids, "hashes": row_hashes(delta.added, ids)}
    for name, array in arrays.items():
        # One new array, filled in one pass: memory traffic is what this function costs.
        dtype = np.promote_types(array.dtype, coming[name].dtype)
        resized = np.empty((len(keep) + len(ids), *array.shape[1:]), dtype)
        array.astype(dtype, copy=False).take(keep, axis=0, out=resized[: len(keep)], mode="clip")
        resized[len(keep) :] = coming[name]
        arrays[name] = resized
    return arrays


def _residuals(before: Attributes, after: Attributes) -> dict[str, IntArray]:
    """The groups that differ anywhere, as differences modulo 2**32."""
    widths = group_channels(before.coefficients)
    changes = {g: group_columns(after, g) - group_columns(before, g) for g in GROUPS if widths[g]}
    return {group: change for group, change in changes.items() if change.any()}


def _checked_rows(rows: NDArray[Any], population: int) -> Rows:
    checked = np.asarray(rows)
    if checked.ndim != 1 or (len(checked) and not np.issubdtype(checked.dtype, np.integer)):
        raise ValueError("rows must be a list of indices")
    indices = checked.astype(np.int64)
    if len(indices) and not (indices.min() >= 0 and indices.max() < population):
        raise ValueError(f"rows must lie in 0..{population - 1}")
    if len(np.unique(indices)) != len(indices):
        raise ValueError("a row is named twice")
    return indices
