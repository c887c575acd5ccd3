"""Training of a later frame: the selected follow the pictures, nothing else is written; growth stays in the focus."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.bench.methods.threedgstream import BaselineConfig, BaselineTrainer
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.methods.decogs import DecogsTrainer, _probes
from decogs.encoder.methods.paper import PaperTrainer
from decogs.encoder.methods.transformation_cache import CacheConfig
from decogs.encoder.settings.frame import EmergenceSettings, FrameSettings, IterationSettings, SignificanceSettings
from decogs.encoder.training.method import TrainedFrame, TrainingContext
from decogs.encoder.training.schedule import MIN_STEPS, Pace, StoppingRule
from decogs.encoder.training.warm_start import shared_displacements
from decogs.formats.errors import TrainingError
from decogs.formats.splats import SH_C0, Splats, take_splats
from noting_kernel import NotingKernel
from one_frame import Case, NewTrainer, Trainer, bits, moved_square, train

SETTINGS = FrameSettings(joint_iterations=30, grow_fraction=0.0, emergence=EmergenceSettings(max_seeds=0))
CACHE = CacheConfig(levels=4, features=2, table_log2=8, base_resolution=4, hidden_width=16, learning_rate=5e-3)
CACHED = partial(PaperTrainer, cache=CACHE, cache_iterations=30)
IDENTITY = partial(PaperTrainer, cache=replace(CACHE, learning_rate=0.0), cache_iterations=1)
"""A cache that learns nothing: with no steps of stage 2, what densification alone does."""


def growing_from(gradient: float, new: NewTrainer) -> NewTrainer:
    """Selected Gaussians are split or cloned from this mean view gradient; from 0, all are."""
    return lambda context: new(replace(context, grow_gradient=gradient))


EAGER = growing_from(0.0, IDENTITY)
METHODS = pytest.mark.parametrize("new", [CACHED, DecogsTrainer], ids=["cache", "direct"])


@pytest.fixture(scope="module")
def case(moving_rig: Path, tiny_rig: Any) -> Case:
    return moved_square(moving_rig, tiny_rig)


def applied(scene: Splats, frame: TrainedFrame) -> Splats:
    result = take_splats(scene, np.arange(len(scene)))
    for name, array in vars(result).items():
        array[frame.kept] = getattr(frame.values, name)
    return result


def error(case: Case, splats: Splats) -> float:
    kernel = CpuKernel(2)
    return float(
        np.mean(
            [
                ((kernel.forward(splats, view.pinhole).rgb - picture) ** 2).mean()
                for view, picture in zip(case.ingest.views, case.pictures, strict=True)
            ]
        )
    )


@pytest.mark.parametrize("unit", [2.0**-10, 2.0**10])
@pytest.mark.parametrize("name", ["cache", "dense", "direct"])
def test_no_method_depends_on_the_unit_of_length(case: Case, name: str, unit: float) -> None:
    """A power of two leaves the numbers' roundings as they are; the logarithms of sizes have others."""

    def dense(context: TrainingContext) -> BaselineTrainer:
        config = BaselineConfig(cache=CACHE, cache_iterations=30, spawn_iterations=4)
        return BaselineTrainer(replace(context, population=len(case.scene)), config)

    new: Any = {"cache": CACHED, "dense": dense, "direct": DecogsTrainer}[name]
    found = [error(each, applied(each.scene, each.train(SETTINGS, new))) for each in (case, case.in_units(unit))]
    assert found[1] == pytest.approx(found[0], rel=0.05)
    assert found[0] != pytest.approx(error(case, case.scene), rel=0.05), "something was trained"


@METHODS
@pytest.mark.parametrize("gain", [4, 0.125])
def test_colours_follow_a_light_that_steps_do_not_reach(case: Case, new: NewTrainer, gain: float) -> None:
    """A tenth of the squared error that the same steps leave without gains; times 4 half of the pixels are clipped."""
    kernel, few = CpuKernel(2), replace(SETTINGS, joint_iterations=4)
    drawn = [kernel.forward(case.scene, view.pinhole).rgb.copy() for view in case.ingest.views]
    pictures = [np.clip(np.float32(gain) * picture, 0, 1) for picture in drawn]
    lit = replace(case, selected=np.ones(len(case.scene), bool), pictures=pictures)
    left = [error(lit, applied(lit.scene, lit.train(few, new, relit=relit))) for relit in (False, True)]
    assert left[1] < 0.1 * left[0]


@METHODS
def test_black_follows_a_light_as_well(case: Case, new: NewTrainer) -> None:
    """Colours a little below black have no gradient; given the light that there was, a tenth of the error is left."""
    kernel, sh = CpuKernel(2), case.scene.sh.copy()
    sh[:, 0] = (-0.02 - 0.5) / SH_C0
    pictures = [np.clip(kernel.forward(case.scene, view.pinhole).rgb, 0, 1) for view in case.ingest.views]
    black, selected = replace(case.scene, sh=sh), np.ones(len(case.scene), bool)
    dark = replace(case, scene=black, selected=selected, pictures=pictures)
    lit = applied(black, dark.train(replace(SETTINGS, joint_iterations=0), new, relit=True))
    assert error(dark, lit) < 0.1 * error(dark, black)


@METHODS
def test_the_selected_follow_the_pictures_and_the_scene_given_stays_as_it_is(case: Case, new: NewTrainer) -> None:
    before = bits(case.scene)
    frame = case.train(SETTINGS, new)
    assert bits(case.scene) == before
    np.testing.assert_array_equal(frame.kept, np.flatnonzero(case.selected))
    assert (len(frame.removed), len(frame.added)) == (0, 0)
    assert (frame.values.means != case.scene.means[case.selected]).any(axis=1).all()
    # The square moves by 0.1; a third of the error gone shows that it is followed (60 steps do not finish the way).
    assert error(case, applied(case.scene, frame)) < 0.67 * error(case, case.scene)
    shift = (frame.values.means - case.scene.means[case.selected]).mean(axis=0)
    assert shift[0] > 0.005
    assert abs(shift[1]) < 0.5 * shift[0]


def test_the_cache_alone_moves_and_turns_and_touches_nothing_else(case: Case) -> None:
    frame = case.train(replace(SETTINGS, joint_iterations=0), CACHED)
    old = take_splats(case.scene, frame.kept)
    for name in ("log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(frame.values, name), getattr(old, name))
    assert (frame.values.means != old.means).any()
    assert error(case, applied(case.scene, frame)) < error(case, case.scene)


def test_results_depend_on_the_seed_and_not_on_threads(case: Case) -> None:
    settings, new = replace(SETTINGS, grow_fraction=0.5), growing_from(0.0, CACHED)
    one, five, other = (case.train(settings, new, **o) for o in ({"threads": 1}, {"threads": 5}, {"seed": 1}))
    assert len(one.added) > 0
    assert bits(one.values) + bits(one.added) == bits(five.values) + bits(five.added)
    assert bits(one.values) != bits(other.values)


def test_on_a_stage_neighbours_move_more_alike(case: Case) -> None:
    """Displacements are smoothed at half of the steps: what the other half adds is left of their differences."""

    def differences(**stage: Any) -> float:
        frame = case.train(SETTINGS, **stage)
        before = case.scene.means[frame.kept]
        moved = frame.values.means - before
        return float(np.abs(moved - shared_displacements(before, moved, 16)).mean())

    def nowhere(means: np.ndarray) -> np.ndarray:
        return np.zeros(len(means), bool)

    assert differences(stage=SimpleNamespace(free=nowhere, on_backdrop=nowhere)) < 0.8 * differences()


GROWING = replace(SETTINGS, joint_iterations=0, grow_fraction=1.0, prune_opacity=0.0)


def grown(case: Case, *, everywhere: bool) -> TrainedFrame:
    scene = take_splats(case.scene, np.arange(len(case.scene)))
    scene.log_scales[case.selected] = np.log(0.05)  # above 1 % of the extent: split, not cloned
    return replace(case, scene=scene).train(GROWING, EAGER, everywhere=everywhere)


def test_halves_born_in_the_focus_lie_about_their_parents_old_place(case: Case) -> None:
    frame = grown(case, everywhere=True)
    assert len(frame.added) == len(frame.kept) == 25
    places = case.scene.means[frame.kept]
    np.testing.assert_allclose((frame.added.means + frame.values.means) / 2, places, atol=1e-6)
    assert (frame.added.means != places).any(axis=1).all()
    np.testing.assert_allclose(np.exp(frame.values.log_scales), 0.05 / 1.6, rtol=1e-5)


def test_a_new_gaussian_outside_every_focus_goes_back_to_its_parents_place(case: Case) -> None:
    frame = grown(case, everywhere=False)
    assert len(frame.added) == 25
    np.testing.assert_array_equal(frame.added.means, case.scene.means[frame.kept])


def test_one_view_with_the_place_in_its_focus_is_enough(case: Case) -> None:
    free, bound = grown(case, everywhere=True), grown(case, everywhere=False)
    masks = case.masks(everywhere=False)
    masks[3] = case.masks(everywhere=True)[3]
    scene = take_splats(case.scene, np.arange(len(case.scene)))
    scene.log_scales[case.selected] = np.log(0.05)
    frame = replace(case, scene=scene).train(GROWING, EAGER, masks=masks)
    np.testing.assert_array_equal(frame.added.means, free.added.means)
    assert (frame.added.means != bound.added.means).any()


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        (CACHED, [("cache", step) for step in range(20, 30)]),
        (DecogsTrainer, [("joint", step) for step in range(7, 15)]),
    ],
    ids=["last third of stage 1", "second quarter"],
)
def test_growth_goes_by_gradients_shortly_before_it(
    case: Case, new: NewTrainer, expected: list[tuple[str, int]]
) -> None:
    kernel = NotingKernel(2)
    stopping = StoppingRule(on_loss=lambda stage, step, loss: kernel.done.append((stage, step)))
    case.train(SETTINGS, lambda context: new(replace(context, kernel=kernel)), stopping=stopping)
    assert [before for before, (what, _) in pairwise(kernel.done) if what == "gather"] == expected


def test_growth_is_limited_by_gradient_share_and_scene(case: Case) -> None:
    assert len(grown(case, everywhere=True).added) == 25
    for share, most in ((0.2, 5), (1e-3, 1)):
        assert len(case.train(replace(GROWING, grow_fraction=share), EAGER).added) == most
    assert not len(case.train(GROWING, growing_from(1e9, IDENTITY)).added)
    bounded = len(case.scene) + 3
    frame = case.train(GROWING, lambda context: EAGER(replace(context, max_gaussians=bounded)))
    assert len(frame.added) == 3


@pytest.mark.parametrize(("steps", "new"), [(30, CACHED), (0, IDENTITY)], ids=["cache", "nothing"])
def test_faint_gaussians_go_if_they_were_selected(case: Case, steps: int, new: NewTrainer) -> None:
    scene = take_splats(case.scene, np.arange(len(case.scene)))
    selected = np.flatnonzero(case.selected)
    faint = np.concatenate([selected[[4, 7]], [11, 12]])  # rows 11 and 12 are of the wall, which nobody selected
    scene.opacity_logits[faint] = -7.0
    frame = replace(case, scene=scene).train(replace(SETTINGS, joint_iterations=steps), new)
    np.testing.assert_array_equal(frame.removed, selected[[4, 7]])
    np.testing.assert_array_equal(frame.kept, np.delete(selected, [4, 7]))
    assert len(frame.values) == 23


def test_the_cache_begins_anew_in_every_frame(case: Case) -> None:
    """A second frame without any step is moved by nothing of what the first one taught."""
    trainer = case.trainer(replace(SETTINGS, joint_iterations=0), CACHED)
    assert isinstance(trainer, PaperTrainer)
    given = (case.selected, case.pictures, case.masks(everywhere=True))
    first = train(trainer, case.scene, *given, frame=1)
    assert (first.values.means != case.scene.means[first.kept]).any()
    for view in trainer.context.static_views:
        view.commit(case.scene, np.flatnonzero(case.selected))
    trainer.cache_iterations = 0
    second = train(trainer, case.scene, *given, frame=2)
    np.testing.assert_array_equal(second.values.means, case.scene.means[second.kept])


@METHODS
def test_a_frame_is_trained_alike_whatever_was_trained_before(case: Case, new: NewTrainer) -> None:
    given = (case.selected, case.pictures, case.masks(everywhere=True))
    trainer = case.trainer(SETTINGS, new)
    results = []
    for frame in (1, 2, 1):
        trained = train(trainer, case.scene, *given, frame=frame)
        results.append(bits(trained.values) + bits(trained.added))
        for view in trainer.context.static_views:
            view.commit(case.scene, np.flatnonzero(case.selected))
            view.redraw()
    assert results[0] == results[2] != results[1]


def test_a_loss_that_is_not_finite_names_the_camera(case: Case) -> None:
    pictures = [*case.pictures[:4], np.full_like(case.pictures[4], np.nan)]
    with pytest.raises(TrainingError, match="the loss of camera cam04 is nan"):
        case.train(SETTINGS, pictures=pictures)


def test_what_is_trained_is_what_a_whole_rendering_trains(case: Case) -> None:
    """The frame's loss falls as the pictures of the views say: no view keeps showing what has moved away."""
    trainer = case.trainer(SETTINGS)
    frame = train(trainer, case.scene, case.selected, case.pictures, case.masks(everywhere=True), frame=1)
    now, kernel = applied(case.scene, frame), CpuKernel(1)
    for view, watching in zip(case.ingest.views, trainer.context.static_views, strict=True):
        watching.commit(now, np.flatnonzero(case.selected))
        watching.redraw()
        np.testing.assert_array_equal(watching.rgb, kernel.forward(now, view.pinhole).rgb)


def steps_of(case: Case, trainer: Trainer, pictures: list[np.ndarray], **other: Any) -> int:
    """The steps of stage 2."""
    steps: list[int] = []
    stopping = StoppingRule(on_loss=lambda stage, step, loss: steps.append(step))
    masks = case.masks(everywhere=True)
    train(trainer, case.scene, case.selected, pictures, masks, frame=1, stopping=stopping, **other)
    return len(steps)


def test_what_the_scene_misses_at_its_start_makes_a_frame_longer_or_shorter(case: Case) -> None:
    def steps(pictures: list[np.ndarray], usual_miss: float, **other: Any) -> int:
        trainer = case.trainer(
            replace(SETTINGS, adaptive_iterations=IterationSettings(usual_miss=usual_miss, min_factor=0.5))
        )
        return steps_of(case, trainer, pictures, **other)

    shown = [CpuKernel(2).forward(case.scene, view.pinhole).rgb for view in case.ingest.views]
    assert steps(shown, 0.5) == 15
    # Strides of a third of a step add up to 30 with rounding.
    assert steps(case.pictures, 1e-6) in (90, 91)
    assert steps([1 - picture for picture in shown], 0.0) == 30
    brighter, darker = ([np.clip(gain * picture, 0, 1) for picture in shown] for gain in (2, 0.5))
    assert steps(brighter, 1.0, relit=True) in (180, 181)
    assert steps(darker, 1.0, relit=True) <= 30, "as what is missed says, which is all of it at most"


def test_errors_are_measured_in_four_views_where_time_is_short() -> None:
    """Each is drawn twice; else in every third view."""
    for seconds, views in ((20, 4), (60, 7)):
        stopping = StoppingRule(deadline=time.perf_counter() + seconds)
        frame = SimpleNamespace(stopping=stopping, pace=Pace(step=1.0))
        training: Any = SimpleNamespace(frame=frame, settings=SETTINGS, used=range(10, 30))
        assert len(_probes(training)) == views


@pytest.mark.parametrize(("new", "cached"), [(CACHED, 30), (DecogsTrainer, 0)], ids=["cache", "direct"])
def test_a_target_that_is_reached_ends_the_frame(case: Case, new: NewTrainer, cached: int) -> None:
    """Once every view was drawn, where nothing is reverted; stage 1 goes on to its end."""
    told: list[str] = []
    settings = replace(SETTINGS, significance=SignificanceSettings(threshold=0.0))
    for target, steps in ((1.0, len(case.pictures)), (99.0, 30)):
        told.clear()
        stopping = StoppingRule(target_psnr=target, on_loss=lambda stage, step, loss: told.append(stage))
        case.train(settings, new, stopping=stopping)
        assert (told.count("cache"), told.count("joint")) == (cached, steps)


def test_only_what_light_alone_changes_needs_more_to_move(case: Case) -> None:
    """A change that is just significant stays where things move; colours have the same threshold everywhere."""
    settings = replace(SETTINGS, significance=SignificanceSettings(threshold=30.0))
    count = len(case.scene)
    given: list[Any] = [None, np.zeros(count, bool), case.selected]
    whole, nobody, everybody = (case.train(settings, light_only=light_only) for light_only in given)
    assert bits(whole.values) == bits(nobody.values)

    def changed(frame: TrainedFrame, name: str) -> int:
        return int((getattr(frame.values, name) != getattr(case.scene, name)[frame.kept]).sum())

    for name in ("means", "log_scales"):
        assert changed(everybody, name) < changed(whole, name)
    for name in ("opacity_logits", "sh"):
        assert changed(everybody, name) == changed(whole, name)


@pytest.mark.parametrize(
    ("new", "stages"),
    [(partial(CACHED, cache_iterations=60), ["cache", "joint"]), (DecogsTrainer, ["joint"])],
    ids=["cache", "direct"],
)
def test_a_deadline_gone_by_leaves_the_least_of_every_stage(case: Case, new: NewTrainer, stages: list[str]) -> None:
    told: list[tuple[str, int]] = []
    stopping = StoppingRule(deadline=0.0, on_loss=lambda stage, step, loss: told.append((stage, step)))
    frame = case.train(replace(SETTINGS, joint_iterations=60), new, stopping=stopping)
    assert told == [(stage, step) for stage in stages for step in range(MIN_STEPS)]
    assert error(case, applied(case.scene, frame)) < error(case, case.scene)
    assert frame.truncated
    assert not case.train(SETTINGS, new).truncated
