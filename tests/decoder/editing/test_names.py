"""Ids in the output, where they cannot be kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.state import State, attributes_from_columns
from decogs.decoder.editing.names import OWN_IDS, IdMap

FAR = 1 << 40


def scene(*ids: int, next_id: int | None = None) -> State:
    means = np.array([[name % 1000, 0, 0] for name in ids], np.int32).reshape(-1, 3)
    return new_state(attributes_from_columns({"means": means}, len(ids), 1), ids=np.array(ids, int), next_id=next_id)


def named(names: IdMap, state: State, *, is_key: bool = False, lists_all: bool = True) -> list[int]:
    return names.of(state, is_key=is_key, lists_all=lists_all, is_changed=False).tolist()


def test_own_ids_are_kept_while_all_are_own() -> None:
    names = IdMap()
    assert named(names, scene(1, 5, 9, next_id=20), is_key=True) == [1, 5, 9]
    assert named(names, scene(5, 9, 20, next_id=21)) == [5, 9, 20]
    assert named(names, scene(1, 9, 20, 30, next_id=40), is_key=True) == [1, 9, 20, 30]
    assert names.next_id == 40


def test_what_a_delta_adds_follows_the_next_id_and_no_id_comes_back() -> None:
    names = IdMap()
    named(names, scene(0, 1, next_id=10), is_key=True)
    assert named(names, scene(0, 1, 12, next_id=13)) == [0, 1, 10]
    assert named(names, scene(0, 12, 13, next_id=14)) == [0, 10, 11]
    # 1 has its name from the first keyframe; 11 was nobody's; 12 keeps the name that it got.
    assert named(names, scene(1, 11, 12, next_id=20), is_key=True) == [1, 12, 10]
    assert named(names, scene(50, next_id=60), is_key=True) == [50]


def test_ids_that_no_keyframe_can_list_are_numbered_anew() -> None:
    names = IdMap()
    assert named(names, scene(0, 1, FAR, next_id=FAR + 1), is_key=True) == [0, 1, 2]
    limit = 1 << 35  # what a keyframe's numbers can say
    assert named(IdMap(), scene(0, limit, next_id=FAR), is_key=True) == [0, limit]
    assert named(IdMap(), scene(0, limit + 1, next_id=FAR), is_key=True) == [0, 1]
    names = IdMap()
    assert named(names, scene(0, 1, next_id=FAR), is_key=True) == [0, 1]
    assert named(names, scene(0, FAR, next_id=FAR + 1)) == [0, FAR]
    assert named(names, scene(0, FAR, next_id=FAR + 1), is_key=True, lists_all=False) == [0, FAR]
    ids = named(names, scene(0, FAR, next_id=FAR + 1), is_key=True)
    assert ids == [FAR + 1, FAR + 2]
    write_key(scene(*ids))


def test_ids_of_other_takes_are_never_kept() -> None:
    names = IdMap()
    both = scene(3, OWN_IDS, OWN_IDS + 7, next_id=OWN_IDS + 8)
    assert named(names, both, is_key=True) == [0, 1, 2]
    assert named(names, scene(3, 4, OWN_IDS + 7, next_id=OWN_IDS + 8)) == [0, 3, 2]


def test_ids_are_looked_up_only_where_somebody_came_or_went(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that shows the scene before it once more costs no search; the next one that does not is as ever."""
    names, state = IdMap(), scene(1, 2, next_id=20)
    named(names, state, is_key=True)
    with monkeypatch.context() as patched:
        patched.delattr("decogs.decoder.editing.names._looked_up")
        assert named(names, replace(state, frame=1)) == [1, 2]
    assert named(names, scene(2, 20, next_id=21)) == [2, 20]
