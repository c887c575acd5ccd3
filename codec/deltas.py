"""Deltas: what changes from one frame's state to the next (SPEC.md, "Applying a delta").

Residuals go to existing rows first, then rows are removed, then new Gaussians are appended. Rows that are in none of
these are bit-identical before and after.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .digest import MASK, array_form, hash_sum, id_form, row_sum
from .morton import morton_order
from .state import (
    ARRAYS,
    GROUPS,
    MAX_ID,
    Attributes,
    IntArray,
    Rows,
    State,
    array_columns,
    array_of,
    check_shapes,
    empty_attributes,
    group_channels,
    group_columns,
    read_only,
    take_rows,
)

_ARRAYS = (*ARRAYS, "ids")


@dataclass(frozen=True, eq=False)
class Delta:
    """The change of one frame.

    ``rows`` (n,) int64, strictly increasing: the touched rows of the previous state; ``residuals`` maps an attribute
    group to what is added modulo 2**32, (n, channels) int32, groups that do not change being absent; ``removed`` (r,)
    int64, strictly increasing: rows of the previous state that go; ``added``: the Gaussians that come, in stream order.
    """

    rows: Rows
    residuals: Mapping[str, IntArray]
    removed: Rows
    added: Attributes


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
    change, moved = _moved_rows(previous, rows, residuals)
    arrays = _resized(previous, delta, stays)
    places = rows_after(delta.removed, rows)
    for name, values in moved.items():
        if arrays[name] is getattr(previous, name):
            arrays[name] = arrays[name].copy()
        arrays[name][places] = values
    next_id = previous.next_id + len(delta.added)
    total = previous.row_sum + change
    if len(delta.removed):
        total -= row_sum(take_rows(previous, delta.removed), previous.ids.take(delta.removed))
    if len(delta.added):
        total += row_sum(delta.added, np.arange(previous.next_id, next_id, dtype=np.int64))
    frozen = {name: read_only(array) for name, array in arrays.items()}
    return State(**frozen, next_id=next_id, frame=previous.frame + 1, row_sum=total & MASK)


def rows_after(removed: Rows, rows: Rows) -> Rows:
    """Where rows that stay are once those of ``removed`` (ascending) are gone."""
    # A row moves up by the number of removed rows before it.
    return rows - np.searchsorted(removed, rows) if len(removed) else rows


def ids_left(previous: State) -> int:
    """How many Gaussians may still be added before the ids run out."""
    return MAX_ID - previous.next_id


def _rows_that_stay(delta: Delta, stays: NDArray[np.bool_]) -> tuple[Rows, Mapping[str, IntArray]]:
    """Touched rows and their residuals without those of rows that are removed anyway."""
    kept = stays.take(delta.rows)
    if kept.all():
        return delta.rows, delta.residuals
    return delta.rows[kept], {group: residual[kept] for group, residual in delta.residuals.items()}


def _moved_rows(previous: State, rows: Rows, residuals: Mapping[str, IntArray]) -> tuple[int, dict[str, IntArray]]:
    """The change of the sum of row hashes, and of the arrays that change the touched rows as they are afterwards."""
    if not len(rows) or not residuals:
        return 0, {}
    before = id_form(previous.ids.take(rows))
    after, moved = before.copy(), {}
    changing = {array_of(group) for group in residuals}
    for name in ARRAYS:
        values: IntArray = getattr(previous, name).take(rows, axis=0)
        form = array_form(values, name)
        before += form
        if name in changing:
            for group, residual in residuals.items():
                if array_of(group) == name:
                    columns = array_columns(values, group)
                    columns += residual
            form, moved[name] = array_form(values, name), values
        after += form
    return hash_sum(after) - hash_sum(before), moved


def _resized(previous: State, delta: Delta, stays: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """The state's arrays without the removed and with the added rows; the very same arrays when there are neither."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(previous, name) for name in _ARRAYS}
    if not len(delta.removed) and not len(delta.added):
        return arrays
    keep = np.flatnonzero(stays)
    size = len(keep) + len(delta.added)
    for name, array in arrays.items():
        # One new array, filled in one pass: memory traffic is what this function costs.
        resized = np.empty((size, *array.shape[1:]), array.dtype)
        array.take(keep, axis=0, out=resized[: len(keep)], mode="clip")
        resized[len(keep) :] = (
            previous.next_id + np.arange(len(delta.added)) if name == "ids" else getattr(delta.added, name)
        )
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
