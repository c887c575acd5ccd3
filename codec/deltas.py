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

from .digest import MASK, group_form, hash_sum, linear_forms, row_sum
from .morton import morton_order
from .state import (
    GROUPS,
    MAX_ID,
    Attributes,
    IntArray,
    Rows,
    State,
    check_shapes,
    empty_attributes,
    group_channels,
    group_columns,
    read_only,
    take_rows,
)

_ARRAYS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "ids")


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
    rows, residuals = _rows_that_stay(delta)
    forms, moved = _moved_columns(previous, rows, residuals)
    arrays = _resized(previous, delta)
    # A row moves up by the number of removed rows before it.
    places = rows - np.searchsorted(delta.removed, rows)
    for group, columns in moved.items():
        _store(arrays, previous, group, places, columns)
    next_id = previous.next_id + len(delta.added)
    total = previous.row_sum + forms
    if len(delta.removed):
        total -= row_sum(take_rows(previous, delta.removed), previous.ids.take(delta.removed))
    if len(delta.added):
        total += row_sum(delta.added, np.arange(previous.next_id, next_id, dtype=np.int64))
    frozen = {name: read_only(array) for name, array in arrays.items()}
    return State(**frozen, next_id=next_id, frame=previous.frame + 1, row_sum=total & MASK)


def ids_left(previous: State) -> int:
    """How many Gaussians may still be added before the ids run out."""
    return MAX_ID - previous.next_id


def _rows_that_stay(delta: Delta) -> tuple[Rows, Mapping[str, IntArray]]:
    """Touched rows and their residuals without those of rows that are removed anyway."""
    gone = np.isin(delta.rows, delta.removed) if len(delta.removed) else np.zeros(0, bool)
    if not gone.any():
        return delta.rows, delta.residuals
    return delta.rows[~gone], {group: residual[~gone] for group, residual in delta.residuals.items()}


def _moved_columns(previous: State, rows: Rows, residuals: Mapping[str, IntArray]) -> tuple[int, dict[str, IntArray]]:
    """The change of the sum of row hashes, and the touched rows' new values per group."""
    if not len(rows) or not residuals:
        return 0, {}
    old = take_rows(previous, rows)
    before = linear_forms(old, previous.ids.take(rows))
    after, moved = before.copy(), {}
    for group, residual in residuals.items():
        columns = group_columns(old, group)
        moved[group] = columns + residual
        after += group_form(moved[group], group, previous.coefficients)
        after -= group_form(columns, group, previous.coefficients)
    return hash_sum(after) - hash_sum(before), moved


def _resized(previous: State, delta: Delta) -> dict[str, NDArray[Any]]:
    """The state's arrays without the removed and with the added rows; the very same arrays when there are neither."""
    arrays: dict[str, NDArray[Any]] = {name: getattr(previous, name) for name in _ARRAYS}
    if not len(delta.removed) and not len(delta.added):
        return arrays
    keep = np.delete(np.arange(len(previous)), delta.removed)
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


def _store(arrays: dict[str, NDArray[Any]], previous: State, group: str, rows: Rows, values: IntArray) -> None:
    """Writes one group's values, into a copy if the array is still the previous state's."""
    name = "sh" if group.startswith("sh_") else group
    if arrays[name] is getattr(previous, name):
        arrays[name] = arrays[name].copy()
    if group == "sh_dc":
        arrays[name][rows, 0] = values
    elif group == "sh_rest":
        arrays[name][rows, 1:] = values.reshape(len(values), -1, 3)
    else:
        arrays[name][rows] = values[:, 0] if group == "opacity_logits" else values


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
