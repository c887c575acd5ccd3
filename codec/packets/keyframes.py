"""Keyframes: a scene put in stream order, with ids from the running counter (SPEC.md, "Key packet")."""

from __future__ import annotations

import numpy as np

from ..scene.digest import row_hashes
from ..scene.morton import morton_order
from ..scene.state import ARRAYS, MAX_ID, Attributes, Rows, State, check_shapes, narrowed, read_only, take_rows


def new_state(attributes: Attributes, frame: int = 0, *, ids: Rows | None = None, next_id: int | None = None) -> State:
    """A state of these Gaussians in their given order; ids default to 0, 1, 2, ...

    ``ids`` must increase strictly. Raises ValueError when arrays, ids or next id do not fit.
    """
    check_shapes(attributes)
    ids = np.arange(len(attributes), dtype=np.int64) if ids is None else np.asarray(ids, np.int64)
    last = int(ids[-1]) if len(ids) else -1
    next_id = last + 1 if next_id is None else next_id
    if ids.shape != (len(attributes),) or (ids[1:] <= ids[:-1]).any() or (len(ids) and ids[0] < 0):
        raise ValueError("ids must be one per Gaussian, strictly increasing from 0 or above")
    if not last < next_id <= MAX_ID:
        raise ValueError(f"next id {next_id} is not above the last id {last}")
    arrays = {name: narrowed(getattr(attributes, name)) for name in ARRAYS}
    frozen = {name: read_only(array) for name, array in {**arrays, "ids": ids}.items()}
    return State(**frozen, hashes=read_only(row_hashes(Attributes(**arrays), ids)), next_id=next_id, frame=frame)


def keyframe_state(attributes: Attributes, frame: int = 0, *, first_id: int = 0) -> tuple[State, Rows]:
    """The state a keyframe opens with, in Morton order, and that order: row i is ``attributes``' row ``order[i]``.

    Ids run from ``first_id``: a keyframe that continues a stream passes the former state's ``next_id``.
    """
    order = morton_order(attributes.means)
    ids = first_id + np.arange(len(attributes), dtype=np.int64)
    return new_state(take_rows(attributes, order), frame, ids=ids, next_id=first_id + len(attributes)), order
