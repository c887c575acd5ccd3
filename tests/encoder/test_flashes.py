"""A flash: what may be one, when it is over, and what of the frames before it comes back."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.change.flashes import MAX_FLASH_FRAMES, changes_most, matches
from decogs.encoder.change.masks import MaskMemory, PixelChange
from decogs.encoder.frame.events import PendingFrame, what_happened
from decogs.encoder.frame.memory import Memory
from decogs.encoder.settings.frame import MaskSettings
from decogs.encoder.settings.presets import preset
from decogs.encoder.stopwatch import Stopwatch
from decogs.rig.pictures.ingest import RigFrame

MASKS = MaskSettings(threshold=10.0)
DARK = np.random.default_rng(1).uniform(0.1, 0.4, (3, 5, 6)).astype(np.float32).repeat(8, 1).repeat(8, 2)
BRIGHT, BRIGHTER = (np.minimum(factor * DARK, 1) for factor in (2, 3))
SETTINGS = replace(preset("draft"), frame=replace(preset("draft").frame, masks=MASKS))


@pytest.mark.parametrize(("rows", "over"), [(0, True), (8, True), (9, True), (11, False), (40, False)])
def test_it_is_over_where_less_than_a_quarter_differs_from_before(rows: int, over: bool) -> None:
    """Rows of 40 that something else has changed meanwhile, in the median view."""
    now = DARK.copy()
    now[:, :rows] += 0.5
    assert matches(MaskMemory.begin([DARK] * 3), [now, now, BRIGHT], MASKS) == over


@pytest.mark.parametrize(("share", "may_be"), [(0.4, False), (0.6, True)])
def test_only_views_that_show_their_frame_say_what_may_be_one(share: float, may_be: bool) -> None:
    raw = np.arange(10)[None] < 10 * share
    lost = PixelChange(np.zeros((1, 10), bool), 0.0, lost="black")
    picture = np.zeros((3, 1, 10), np.float32)
    assert changes_most(MaskMemory.begin([picture] * 3), [PixelChange(raw, 0.0), lost, lost]) == may_be
    assert not changes_most(MaskMemory.begin([picture]), [lost])


def memory_of(picture: np.ndarray) -> Memory:
    trainer: Any = SimpleNamespace()
    views: Any = SimpleNamespace(pictures=lambda splats: [DARK])
    return Memory(trainer, MaskMemory.begin([picture]), None, None, None, views)


def happened(index: int, picture: np.ndarray, memory: Memory, scene: Any) -> PendingFrame:
    context: Any = SimpleNamespace(
        settings=SETTINGS,
        method=SimpleNamespace(dense=False),
        threads=1,
        ingest=SimpleNamespace(views=[]),
    )
    recorded = RigFrame(index, [picture], [])
    return what_happened(context, PendingFrame(recorded, recorded, {}, scene, memory), Stopwatch())


def scene_of(state: str) -> Any:
    return SimpleNamespace(state=state, splats=None, roll_back=lambda was: scene_of(f"{was} for {state}"))


def test_state_and_masks_of_before_come_back_after_it() -> None:
    """Two bright frames: the state before the first one, not between the two."""
    before = memory_of(DARK)
    first = happened(3, BRIGHT, before, scene_of("before"))
    assert not first.is_return
    masks = MaskMemory.begin([BRIGHT])
    between = replace(first.memory, masks=masks)
    second = happened(4, BRIGHTER, between, scene_of("between"))
    kept = second.memory.before_flash
    assert kept is not None
    assert (kept.since, kept.state) == (3, "before")
    last = replace(second.memory, masks=masks)
    over = happened(5, DARK, last, scene_of("bright"))
    assert (over.scene.state, over.is_return) == ("before for bright", True)
    assert over.memory.masks is before.masks
    assert over.memory.before_flash is None


def test_a_light_is_a_flash_for_so_many_frames_and_then_stays() -> None:
    memory = happened(3, BRIGHT, memory_of(DARK), scene_of("before")).memory
    memory = replace(memory, masks=MaskMemory.begin([BRIGHT]))
    for index, waits in ((3 + MAX_FLASH_FRAMES, True), (3 + MAX_FLASH_FRAMES + 1, False)):
        memory = happened(index, BRIGHT, memory, scene_of("bright")).memory
        assert (memory.before_flash is not None) == waits
    assert not happened(13, DARK, memory, scene_of("bright")).is_return


def test_what_training_has_not_reached_yet_begins_no_flash() -> None:
    """The bright picture is still compared with the dark one, on which all was last trained."""
    memory = memory_of(DARK)
    unreached = replace(memory, masks=replace(memory.masks, previous=[BRIGHT]))
    assert happened(3, BRIGHT, unreached, scene_of("bright")).memory.before_flash is None
    assert happened(3, BRIGHT, memory, scene_of("before")).memory.before_flash is not None
