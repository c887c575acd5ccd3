"""The ids of Gaussians in the stream that is written: their own where they can be kept, new ones where not.

A delta numbers what it adds one after the other (SPEC.md, "Applying a delta"). Where an edit leaves some of that out,
or brings the Gaussians of two takes together, the others need other ids. One that has an id keeps it while it is there;
so does one of the first keyframe, to which later segments go back.
"""

from __future__ import annotations

import numpy as np

from decogs.codec.packets.refinement import LAYER_IDS
from decogs.codec.scene.morton import morton_order
from decogs.codec.scene.state import Rows, State, take_rows

OWN_IDS = 1 << 52
"""Below this are the ids of the stream that is edited; those of others are above, and get new ones."""

_MAX_GAP = 1 << 35
"""Between two ids that a keyframe can list (SPEC.md, "Varint")."""


class IdMap:
    """Ids in the output by ids in the edited take, for the Gaussians of the last frame and of the first keyframe."""

    def __init__(self, first: int = 0, *, begins_anew: bool = False) -> None:
        """``first``: the least id that is given; ``begins_anew``: no Gaussian of the first keyframe keeps its own."""
        self._range = range(first, first + LAYER_IDS if first else OWN_IDS)
        self._begins_anew = begins_anew
        self._last = self._first = (np.zeros(0, np.int64), np.zeros(0, np.int64))
        self._all_own = True
        self.next_id = first

    def of(self, state: State, *, is_key: bool, lists_all: bool, is_changed: bool) -> Rows:
        """The output's ids (N,) of a frame's rows; those of a keyframe that are new keep theirs where that can be.

        ``lists_all``: whether the keyframe may have to list all its ids, not only those that the first one has not.
        ``is_changed``: no packet that was read leads to this scene. A first keyframe is then put in Morton order, which
        is smaller and which it may have lost; no packet behind it could stay anyway.
        """
        if not is_key and state.ids is self._last[0]:
            return self._last[1]  # nobody came or went
        ids_before = _joined(self._last, self._first) if is_key else self._last
        ids = _looked_up(ids_before, state.ids)
        new = np.flatnonzero(ids < 0)
        own = state.ids[new]
        kept = np.where(ids < 0, state.ids, ids)
        # As long as nobody has another's id, an own one is nobody else's; otherwise those are that nobody had yet.
        is_ours = (own >= self._range.start) & (own < self._range.stop)
        are_free = bool((is_ours & (self._all_own | (own >= self.next_id))).all())
        begins = is_key and not len(self._first[0])
        anew = begins and (is_changed or self._begins_anew)
        if is_key and not anew and are_free and _can_be_listed(np.sort(kept) if lists_all else own):
            ids = kept
            # Where another take's Gaussians are in the frame, its next id is theirs.
            own_next = state.next_id if state.next_id < self._range.stop else int(kept.max(initial=-1)) + 1
            self.next_id = max(self.next_id, own_next)
        else:
            # As a delta orders what it adds; the packets behind a keyframe can stay where its rows do.
            order = np.arange(len(new)) if is_key and not anew else morton_order(take_rows(state, new).means)
            ids[new[order]] = self.next_id + np.arange(len(new))
            self.next_id += len(new)
        if is_key and lists_all and not _can_be_listed(np.sort(ids)):
            ids = self.next_id + np.arange(len(ids))
            self.next_id += len(ids)
        self._all_own = self._all_own and np.array_equal(ids, state.ids)
        self._last = (state.ids, ids)
        if begins:
            self._first = self._last
        return ids


def _can_be_listed(ids: Rows) -> bool:
    """Whether ids that rise are near enough to each other for a keyframe to list them."""
    return bool(np.diff(ids).max(initial=0) <= _MAX_GAP)


def _looked_up(ids_before: tuple[Rows, Rows], ids: Rows) -> Rows:
    """The output's ids, -1 where there is none."""
    inner, outer = ids_before
    if not len(inner):
        return np.full(len(ids), -1, np.int64)
    indices = np.searchsorted(inner, ids).clip(max=len(inner) - 1)
    return np.where(inner[indices] == ids, outer[indices], -1)


def _joined(first: tuple[Rows, Rows], second: tuple[Rows, Rows]) -> tuple[Rows, Rows]:
    inner, indices = np.unique(np.concatenate([first[0], second[0]]), return_index=True)
    return inner, np.concatenate([first[1], second[1]])[indices]
