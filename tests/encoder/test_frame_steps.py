"""Steps of one later frame, each by itself on made-up values: plan, training, commit, replay, the next segment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import decogs.encoder.frame.encode_frame as encode_frame
from decogs.codec.packets.corrections import CorrectedCameras, Correction
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import ARRAYS, Attributes, State
from decogs.decoder.subject.hull import Hull
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.scene_views import SceneViews
from decogs.encoder.change.masks import FrameMask, MaskMemory, PixelChange
from decogs.encoder.coding.packets import key_packet
from decogs.encoder.coding.rate_control import RateControl
from decogs.encoder.coding.scene import IDS_PER_SEGMENT, Scene
from decogs.encoder.coding.time_control import TimeControl
from decogs.encoder.frame.commit import next_memory
from decogs.encoder.frame.cross_fade import CrossFade, cross_fade, fade_cameras
from decogs.encoder.frame.encode_frame import Task
from decogs.encoder.frame.events import Kind, PendingFrame, what_happened
from decogs.encoder.frame.first_look import FirstLook
from decogs.encoder.frame.memory import Memory, restart_at_segment
from decogs.encoder.frame.next_segment import NextSegment
from decogs.encoder.frame.plan import FramePlan, find_selected, light_only, plan_frame
from decogs.encoder.frame.segment_starts import SceneStart, SegmentStarts
from decogs.encoder.frame.train import train_frame
from decogs.encoder.input.compensation.colour import remove_gain
from decogs.encoder.settings.frame import SelectionSettings
from decogs.encoder.settings.presets import preset
from decogs.encoder.stopwatch import Stopwatch
from decogs.encoder.training.method import TrainedFrame
from decogs.encoder.training.schedule import UNKNOWN_PACE, Pace
from decogs.formats.errors import TrainingError
from decogs.formats.splats import Splats, empty_splats
from decogs.formats.stream.container import PacketKind
from decogs.rig.pictures.ingest import RigFrame, scene_extent
from decogs.rig.stage.stage import PlainStage
from decogs.rig.stage.subject import SubjectAlone

Stub: Any = SimpleNamespace
DRAFT = preset("draft")
PICTURE = np.random.default_rng(1).uniform(0.1, 0.6, (3, 6, 8)).astype(np.float32).repeat(8, 1).repeat(8, 2)
EVERYWHERE = FrameMask(np.ones((48, 64), bool), np.ones((48, 64), bool))


def state_of(count: int, *moved: int) -> State:
    """So many Gaussians in one place, but for those that have ``moved``."""
    values = Splats(*(np.zeros((count, *shape), np.float32) for shape in ((3,), (3,), (4,), (), (1, 3))))
    values.quaternions[:, 0] = 1
    points = quantise(values, default_lattice(1.0))
    means = np.array(points.means)
    means[list(moved)] += 50
    return new_state(Attributes(**{name: getattr(points, name) for name in ARRAYS} | {"means": means}))


def memory_of(**changes: Any) -> Memory:
    given: dict[str, Any] = {
        "trainer": Stub(),
        "masks": MaskMemory.begin([PICTURE]),
        "corrections": None,
        "rate": None,
        "time": None,
        "views": Stub(pictures=lambda splats: [PICTURE]),
    }
    return Memory(**(given | changes))


def pending(
    index: int = 1, picture: np.ndarray = PICTURE, *, scene: Any = None, memory: Memory | None = None, **event: Any
) -> PendingFrame:
    recorded = RigFrame(index, [picture], [])
    return PendingFrame(recorded, recorded, {}, scene, memory or memory_of(), **event)


# The plan


def planned(
    settings: Any, memory: Memory, picture: np.ndarray, fade: Any = None, changes: Sequence[PixelChange] = ()
) -> FramePlan:
    context = Stub(settings=settings, threads=1)
    frame = pending(picture=picture, scene=Stub(splats=None), memory=memory, changes=changes)
    return plan_frame(context, frame, [EVERYWHERE], np.ones(3, bool), fade, Stopwatch())


def test_a_frame_that_light_alone_changes_is_trained_with_settings_of_its_own() -> None:
    plan = planned(replace(DRAFT, detect_per_frame=True), memory_of(), np.float32(1.3) * PICTURE)
    assert plan.effects == ("appearance_change",)
    assert plan.settings.rates.means == 0 < DRAFT.frame.rates.means


@pytest.mark.parametrize(
    ("gain", "relit"), [(1.05, False), (0.95, False), (2, True), (0.25, True)], ids=["more", "less", "on", "off"]
)
def test_light_that_changes_more_than_steps_follow_is_found_by_what_the_scene_misses(gain: float, relit: bool) -> None:
    picture, settings = (
        np.clip(np.float32(gain) * PICTURE, 0, 1).astype(np.float32),
        replace(DRAFT, detect_per_frame=True),
    )
    of_a_part, of_all = (), [PixelChange(EVERYWHERE.raw, 0.0)]
    plans = [planned(settings, memory_of(), picture, changes=changes) for changes in (of_a_part, of_all)]
    assert [plan.relit for plan in plans] == [relit] * 2
    assert [plan.effects == ("appearance_change",) for plan in plans] == [True, not relit], "all is trained for most"


def test_a_frame_that_goes_over_keeps_to_the_budget_as_well() -> None:
    rate, usual = RateControl(1000.0, 3, octaves=2.0), DRAFT.frame.significance
    for fade, exactness in ((None, 1), (Stub(), 2)):
        found = planned(DRAFT, memory_of(rate=rate), PICTURE, fade).settings.significance
        assert found.threshold == pytest.approx(4 * usual.threshold)
        assert found.rd_lambda == pytest.approx(4 / exactness * usual.rd_lambda)
        assert found.colour_rd_lambda == pytest.approx(4 / exactness * usual.colour_rd_lambda)


def test_on_a_plain_stage_smaller_changes_are_coded_and_of_a_subject_alone_they_are_not() -> None:
    usual = DRAFT.frame.significance
    plain = PlainStage(Hull([]), Stub(), [], np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), 1.0)
    for stage, factor in ((plain, 0.5), (SubjectAlone(Hull([])), 1), (None, 1)):
        found = planned(DRAFT, memory_of(stage=stage), PICTURE).settings.significance
        assert found.threshold == pytest.approx(factor * usual.threshold)
        assert found.rd_lambda == pytest.approx(factor * usual.rd_lambda)


@pytest.mark.parametrize("rule", ["weight", "paper"])
def test_what_light_alone_changes_goes_by_weight_whatever_selects(rule: str) -> None:
    """Shares of .5, .05 and 0 of three Gaussians' weight, whose centres are all where things move."""
    weights = np.ones(3, np.float32), np.array([0.5, 0.05, 0], np.float32)
    view = Stub(redraw=lambda region: weights, centres=lambda: np.full((3, 2), 4, np.float32))
    selected, moving = np.ones(3, bool), [EVERYWHERE.raw] * 2
    found = light_only([view, view], [EVERYWHERE] * 2, selected, moving, SelectionSettings(rule=rule))
    np.testing.assert_array_equal(found, [False, True, True])


def test_of_a_subject_alone_what_stands_in_free_space_is_selected_though_no_picture_changes() -> None:
    class Left(SubjectAlone):
        def in_frame(self, views: Any, frame: Any, used: Any) -> SubjectAlone:
            return self

        def free(self, xyz: Any) -> Any:
            return np.array([False, True, False])

    weights = np.array([1, 1, 1], np.float32), np.zeros(3, np.float32)
    view = Stub(redraw=lambda region: weights, centres=lambda: np.full((3, 2), 4, np.float32))
    scene = Stub(state=np.zeros(3), splats=Stub(means=np.zeros((3, 3), np.float32)))
    context = Stub(settings=DRAFT, ingest=Stub(views=[]))
    for stage, expected in ((Left(Hull([])), [False, True, False]), (None, [False] * 3)):
        memory = memory_of(stage=stage, views=Stub(of=lambda splats: [view, view]))
        frame = Stub(scene=scene, kind=Kind.CHANGE, memory=memory, compensated=None)
        found = find_selected(context, frame, [EVERYWHERE] * 2, Stopwatch())
        np.testing.assert_array_equal(found, expected)


# Training


@pytest.mark.parametrize(
    ("diverges", "rounds", "rejected"),
    [([False] * 3, 3, False), ([True], 1, True), ([False, True], 2, False)],
)
def test_a_round_of_catching_up_that_diverges_is_the_last(diverges: list[bool], rounds: int, rejected: bool) -> None:
    """And the frame is rejected only if it was the first one: what others have changed stays."""
    none, left = empty_splats(0), iter(diverges)
    rows = np.zeros(0, np.int64)
    trainer = Stub(train=lambda frame: TrainedFrame(rows, none, rows, none, rejected=next(left)))

    def scene(number: int) -> Any:
        header = Stub(first_frame=0)
        return Stub(
            number=number, state=state_of(3), splats=none, header=header, with_changes=lambda *_: scene(number + 1)
        )

    context = Stub(
        settings=replace(DRAFT, segment=3, closed=True),
        method=Stub(dense=True),
        ingest=Stub(views=[]),
        stopping=lambda deadline: None,
    )
    memory = memory_of(trainer=trainer, views=Stub(update=lambda *_: None))
    frame = pending(3, scene=scene(1), memory=memory, kind=Kind.EVERYTHING, restarted=True)
    plan = FramePlan([], np.ones(3, bool), ("motion",), DRAFT.frame)
    against, trained = train_frame(context, frame, plan, Stopwatch())
    assert (against.number, trained.rejected) == (rounds, rejected)  # type: ignore[attr-defined]
    assert next(left, None) is None


def test_a_fade_is_trained_with_the_frames_own_settings_and_chance(tiny_rig: Any) -> None:
    """Where light alone changes in frame 7 of the rig, nothing moves for the fade, either."""
    kernel, cameras = CpuKernel(1), [tiny_rig.camera(number) for number in (0, 1, 3)]
    before, after = tiny_rig.scene_at(0), tiny_rig.scene_at(1)
    rows = np.flatnonzero(np.any(before.means != after.means, axis=1))
    rates = replace(DRAFT.frame.rates, means=0.0, quaternions=0.0)
    still = replace(DRAFT.frame, joint_iterations=2, rates=rates)
    none, nobody = empty_splats(before.sh_degree), np.zeros(0, np.int64)

    def fade() -> CrossFade:
        return CrossFade(after, 0.5, rows, SceneViews(kernel, lambda: fade_cameras(cameras)))

    ingest = Stub(views=[Stub(pinhole=camera) for camera in cameras])
    context = Stub(settings=DRAFT, kernel=kernel, ingest=ingest, seed=5, on_loss=None)
    scene = Stub(header=Stub(first_frame=4), splats=before)
    frame = pending(7, scene=scene, memory=memory_of(views=SceneViews(kernel, lambda: cameras)))
    plan = FramePlan([], np.zeros(3, bool), (), still)
    faded = encode_frame._fade(context, frame, plan, scene, None, fade(), Stopwatch())
    np.testing.assert_array_equal(faded.values.means, before.means[rows])
    unchanged, extent = TrainedFrame(nobody, none, nobody, none), scene_extent(ingest.views)
    for seed, same in (((5, 3), True), ((5, 7), False), ((4, 3), False)):
        other = cross_fade(kernel, before, unchanged, fade(), still, extent=extent, seed=seed)
        assert np.array_equal(faded.values.sh, other.values.sh) == same


# What a frame leaves behind


class Masks:
    """Notes what the memory of masks is given."""

    def __init__(self) -> None:
        self.given: dict[str, Any] = {}

    def trained(self, *_: Any, **given: Any) -> Masks:
        self.given |= given
        return self

    def advance(self, *_: Any, **given: Any) -> Masks:
        self.given |= given
        return self


def committed(
    *,
    restarted: bool = False,
    deferred: bool = False,
    truncated: bool = False,
    relit: bool = False,
    rejected: bool = False,
    replayed: Any = None,
    first_frame: int = 0,
    **budgets: Any,
) -> tuple[Memory, Masks]:
    masks: Any = Masks()
    states = ((state_of(3), "old"), (state_of(3, *([] if rejected else [1])), "new"))
    before, after = (Stub(state=state, splats=name) for state, name in states)
    before.header = Stub(first_frame=first_frame)
    context = Stub(settings=DRAFT, corrector=None, threads=1)
    plan = FramePlan([EVERYWHERE], np.ones(3, bool), ("motion",), DRAFT.frame, relit=relit, deferred=deferred)
    memory = memory_of(masks=masks, views=Stub(pictures=lambda splats: f"pictures of {splats}"), **budgets)
    trained = None if deferred else Stub(truncated=truncated, rejected=rejected, pace=Pace(least=0.5))
    frame, watch = pending(scene=before, memory=memory, restarted=restarted, replayed=replayed), Stopwatch()
    watch.seconds["training"] = 0.25
    written: Any = Stub(packet=Stub(kind=PacketKind.DELTA, size=900))
    return next_memory(context, frame, plan, after, trained, written, watch), masks


@pytest.mark.parametrize(
    ("how", "rendered"),
    [
        ({"truncated": True}, "pictures of new"),
        ({"relit": True}, "pictures of new"),
        ({"first_frame": -3}, "pictures of new"),
        ({}, None),
    ],
)
def test_what_training_may_have_missed_is_compared_with_what_came_of_it(how: Any, rendered: str | None) -> None:
    assert committed(**how)[1].given == {
        "moved": True,
        "rendered": rendered,
        "relit": "relit" in how,
        "threads": 1,
        "deferred": False,
    }


def test_what_was_rejected_is_still_to_be_trained() -> None:
    assert committed(rejected=True)[1].given == {"deferred": False}


def test_what_was_deferred_is_still_to_be_trained() -> None:
    _, masks = committed(deferred=True)
    assert masks.given == {"deferred": True}


def test_a_frame_is_paid_for_where_its_memory_is_made() -> None:
    """Bytes, seconds and the pace of training. Of an earlier encode's seconds nothing is known."""
    budgets = {"rate": RateControl(1000.0, 0), "time": TimeControl(1.0)}
    for replayed in (None, state_of(3)):
        memory, _ = committed(replayed=replayed, **budgets)
        assert memory.rate == budgets["rate"].after(PacketKind.DELTA, 900)  # type: ignore[attr-defined]
        assert memory.time is not None
        assert (memory.time.saved, memory.time.pace.least) == ((0.75, 0.5) if replayed is None else (0.0, 0.0))
    deferred, _ = committed(deferred=True, **budgets)
    assert deferred.time is not None
    assert (deferred.time.deferred, deferred.time.kept, deferred.time.pace) == (1, 0.75, UNKNOWN_PACE)


# What happened, replay, cuts


def test_without_an_effect_no_picture_is_compared() -> None:
    context = Stub(settings=Stub(frame_effects=()), method=Stub(dense=False), ingest=Stub(views=[]))
    frame = pending(memory=memory_of(masks=Stub()))
    assert what_happened(context, frame, Stopwatch()).kind is Kind.NOTHING


def test_a_first_look_is_used_if_it_was_of_this_frame() -> None:
    context = Stub(settings=DRAFT, method=Stub(dense=False), ingest=Stub(views=[]), threads=1)
    seen: Any = [PixelChange(np.zeros((48, 64), bool), 0.0)]
    memory = memory_of()
    look: Any = FirstLook(memory.masks, [PICTURE], seen, [], None)
    memory = replace(memory, looking=Stub(taken=lambda: look))
    for picture, used in ((PICTURE, True), (PICTURE.copy(), False)):
        found = what_happened(context, pending(picture=picture, memory=memory, scene=Stub(splats=None)), Stopwatch())
        assert (found.changes is seen) == used


def test_what_a_fade_changed_is_drawn_anew_in_a_replayed_frame() -> None:
    """Beside what the masks select."""
    detached: list[Any] = []
    context, moved = Stub(settings=DRAFT, method=Stub(dense=False)), state_of(4, 2)
    header = Stub(corrected=CorrectedCameras(), coefficients=1)
    before = Stub(state=state_of(4), splats=empty_splats(0), header=header, after=lambda state: Stub(state=state))
    memory = memory_of(views=Stub(of=lambda _: Stub(detach=lambda rows: detached.append(rows))))
    plan = FramePlan([EVERYWHERE], np.arange(4) == 0, ("motion",), DRAFT.frame)
    frame = pending(scene=before, memory=memory)
    packet = key_packet(header, moved, {}).packet
    *_, trained = encode_frame._replay(context, frame, plan, packet, moved)
    assert trained is not None
    for rows in (trained.kept, *detached):
        np.testing.assert_array_equal(rows, [0, 2])
    assert len(detached) == 1


def test_the_keyframe_of_a_cut_is_trained_on_matched_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    colour, seen = Correction(exposure=800), []

    def train(_: Any, recorded: RigFrame, *__: Any) -> None:
        seen.extend(recorded.training)
        raise TrainingError("that is all")

    monkeypatch.setattr(encode_frame, "train_keyframe", train)
    views = [Stub(camera=Stub(name="cam00"), pinhole=None)]
    scene, memory = Stub(header=Stub(camera_colours={"cam00": colour})), memory_of(views=Stub(release=lambda: None))
    frame, task = pending(3, scene=scene, memory=memory, kind=Kind.CUT), Task(RigFrame(3, [PICTURE], []))
    with pytest.raises(TrainingError):
        encode_frame.encode_cut(Stub(ingest=Stub(views=views)), frame, task)
    np.testing.assert_array_equal(seen, [remove_gain(PICTURE, colour.odds_gain)])


def test_a_segment_begins_with_the_first_frame_and_nothing_else(tiny_rig: Any) -> None:
    settings = replace(DRAFT, segment=3, closed=True, frame_budget=1000.0)
    context = Stub(
        settings=settings,
        method=Stub(dense=True, trainer=lambda context: context),
        ingest=Stub(views=[Stub(pinhole=tiny_rig.camera(number), recorded=None) for number in (0, 1)]),
        kernel=None,
        seed=0,
        threads=1,
    )
    key = state_of(4)
    scene = Scene(Stub(lattice=default_lattice(1.0)), key, state_of(4, 1), empty_splats(0))
    corrections: Any = Stub(restart=lambda: "the first frame's")
    first = SceneStart(key, Stub(), RigFrame(0, [PICTURE], []), corrections, stage=Stub())
    starts = SegmentStarts(context.ingest, settings.segment, first)
    flash: Any = Stub()
    memory = memory_of(
        masks=MaskMemory.begin([0.5 * PICTURE]),
        rate=RateControl(1000.0, 3).after(PacketKind.DELTA, 400),
        before_flash=flash,
        starts=starts,
    )
    for given, frame in ((memory, 4), (replace(memory, starts=None), 3)):
        assert restart_at_segment(context, scene, given, frame, Stopwatch()) == (scene, given, False)
    again, fresh, is_start = restart_at_segment(context, scene, memory, 3, Stopwatch())
    assert is_start
    assert again.state.row_sum == key.row_sum
    assert (again.state.frame, again.state.next_id) == (2, key.next_id + IDS_PER_SEGMENT)
    assert (fresh.rate, fresh.corrections) == (RateControl(1000.0, 3), "the first frame's")
    assert fresh.masks.references[0] is fresh.masks.previous[0] is PICTURE
    assert fresh.before_flash is None
    assert (fresh.starts, fresh.stage) == (starts, first.stage)


# The next segment


def segment_from(start: int, scenes: dict[int, Any]) -> NextSegment:
    views: Any = Stub()
    return NextSegment(start, state_of(4), None, scenes, views, 3)


def test_frames_go_over_in_even_steps_and_not_all_the_way() -> None:
    key = state_of(4)
    mine = Stub(state=key)
    segment = segment_from(6, {frame: Stub(state=key, splats=frame) for frame in (3, 4, 5, 6)})
    fades = [segment.fade(frame, mine) for frame in (3, 4, 5)]
    assert [fade.share for fade in fades if fade is not None] == pytest.approx([0.3, 0.6, 0.9])
    assert [fade.scene for fade in fades if fade is not None] == [3, 4, 5]
    assert segment.fade(2, mine) is None


def test_what_either_segment_changed_may_change_for_the_other() -> None:
    """Row 0 here, row 2 there, and row 4, which the keyframe has not."""
    segment = segment_from(6, {5: Stub(state=state_of(4, 2), splats=None)})
    fade = segment.fade(5, Stub(state=state_of(5, 0)))
    assert fade is not None
    np.testing.assert_array_equal(fade.rows, [0, 2, 4])
