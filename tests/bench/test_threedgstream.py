"""The dense baseline: everything moves, spawned Gaussians last one frame, and its stream is an ordinary one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.bench.methods import threedgstream
from decogs.bench.methods.threedgstream import BaselineConfig, BaselineTrainer
from decogs.codec.scene.digest import digest
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.methods.transformation_cache import CacheConfig
from decogs.encoder.training.method import TrainedFrame
from decogs.formats.errors import TrainingError
from decogs.formats.rigs import open_rig
from decogs.formats.splats import Splats, join_splats, take_splats
from decogs.formats.stream.container import PacketKind
from decogs.rig.pictures.ingest import Ingest
from one_frame import train, training_context

BOX = (np.array([-3.5, -3.0, -1.0]), np.array([3.5, 3.0, 1.0]))
LEFT = (BOX[0], np.array([0.0, 3.0, 1.0]))
CONFIG = BaselineConfig(
    CacheConfig(levels=4, features=2, table_log2=8, base_resolution=4, hidden_width=16, learning_rate=5e-3),
    cache_iterations=30,
    spawn_iterations=20,
    prune_every=10,
)
ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


@dataclass(frozen=True)
class Case:
    """The rig's true scene of frame 0 and the pictures of frame 1."""

    ingest: Ingest
    scene: Splats
    pictures: list[np.ndarray]

    def trainer(self, *, threads: int = 2, seed: int = 0, box: Any = BOX, **changes: Any) -> BaselineTrainer:
        given = {"population": len(self.scene), "box": box, "seed": seed, "threads": threads}
        context = training_context(CpuKernel(threads), self.ingest.views, [], **given)
        return BaselineTrainer(context, replace(CONFIG, **changes))

    def train(
        self, trainer: BaselineTrainer, scene: Splats | None = None, pictures: Any = None, frame: int = 1
    ) -> TrainedFrame:
        scene = scene or self.scene
        nothing = (np.zeros(len(scene), bool), pictures or self.pictures, [])  # nobody selected, no masks
        return train(trainer, scene, *nothing, frame=frame)


@pytest.fixture(scope="module")
def case(moving_rig: Path, tiny_rig: Any) -> Case:
    ingest = Ingest(open_rig(moving_rig))
    return Case(ingest, tiny_rig.scene_at(0), next(ingest.frames(1, 2)).training)


def bits(splats: Splats) -> bytes:
    return b"".join(getattr(splats, name).tobytes() for name in ATTRIBUTES)


def error(case: Case, splats: Splats) -> float:
    kernel = CpuKernel(2)
    pairs = zip(case.ingest.views, case.pictures, strict=True)
    return float(np.mean([((kernel.forward(splats, v.pinhole).rgb - p) ** 2).mean() for v, p in pairs]))


# Training


def test_the_released_numbers() -> None:
    """docs/METHOD.md, "Gated neural transformation cache", and 3DGStream's released configuration."""
    config, cache = BaselineConfig(), CacheConfig()
    assert (config.cache_iterations, config.spawn_iterations, config.cache) == (150, 100, cache)
    assert (cache.levels, cache.features, cache.table, cache.base_resolution) == (16, 4, 1 << 15, 16)
    assert (cache.level_scale, cache.hidden_layers, cache.hidden_width, cache.learning_rate) == (2.0, 2, 64, 2e-3)
    assert (config.spawn_gradient, config.prune_opacity, threedgstream.DISSIMILARITY) == (1.5e-4, 0.01, 0.2)
    rates = threedgstream.RATES
    np.testing.assert_allclose(
        [rates.means, rates.sh_dc, rates.sh_rest, rates.opacity_logits, rates.log_scales, rates.quaternions],
        [0.0024, 0.0375, 0.0375 / 20, 0.75, 0.075, 0.015],
        rtol=1e-12,
    )


def test_stage_1_moves_every_gaussian_in_the_box_and_nothing_but_places_and_rotations(case: Case) -> None:
    before = bits(case.scene)
    frame = case.train(case.trainer(box=LEFT, spawn_iterations=0, spawn_gradient=1e9))
    assert bits(case.scene) == before
    np.testing.assert_array_equal(frame.kept, np.arange(len(case.scene)))
    assert (len(frame.removed), len(frame.added)) == (0, 0)
    inside = ((case.scene.means >= LEFT[0]) & (case.scene.means <= LEFT[1])).all(axis=1)
    assert 0 < inside.sum() < len(inside)
    np.testing.assert_array_equal((frame.values.means != case.scene.means).any(axis=1), inside)
    for name in ("log_scales", "opacity_logits", "sh"):
        np.testing.assert_array_equal(getattr(frame.values, name), getattr(case.scene, name))


def test_both_stages_bring_a_displaced_scene_nearer_to_the_pictures(case: Case) -> None:
    displaced = take_splats(case.scene, np.arange(len(case.scene)))
    displaced.means[:, 0] += 0.05
    first = case.train(case.trainer(cache_iterations=80, spawn_gradient=1e9), displaced)
    both = case.train(case.trainer(cache_iterations=80, spawn_gradient=1e-5), displaced)
    assert len(both.added) > 10
    whole = join_splats(both.values, both.added)
    assert error(case, whole) < error(case, first.values) < 0.67 * error(case, displaced)


def test_stage_2_leaves_the_moved_gaussians_alone(case: Case) -> None:
    short, long = (case.train(case.trainer(spawn_gradient=1e-5, spawn_iterations=n)) for n in (0, 20))
    assert bits(short.values) == bits(long.values)
    assert bits(short.added) != bits(long.added)


def test_spawned_gaussians_begin_faint_and_upright_beside_their_parents(case: Case) -> None:
    turned = take_splats(case.scene, np.arange(len(case.scene)))
    turned.quaternions[:] = 0.5  # a third of a turn about (1, 1, 1): the first sigma lies along y, the last along x
    still = replace(CONFIG.cache, learning_rate=0.0)
    frame = case.train(case.trainer(box=LEFT, cache=still, spawn_gradient=0.0, spawn_iterations=0), turned)
    inside = ((turned.means >= LEFT[0]) & (turned.means <= LEFT[1])).all(axis=1)
    parents = take_splats(turned, np.flatnonzero(inside))
    assert len(frame.added) == len(parents) > 900
    np.testing.assert_array_equal(frame.added.quaternions, np.tile(np.float32([1, 0, 0, 0]), (len(parents), 1)))
    np.testing.assert_allclose(1 / (1 + np.exp(-frame.added.opacity_logits)), 0.1, rtol=1e-6)
    np.testing.assert_allclose(frame.added.log_scales, parents.log_scales + np.log(1.25), rtol=1e-5)
    np.testing.assert_array_equal(frame.added.sh, parents.sh)
    offsets = (frame.added.means - parents.means) / (2 * np.exp(parents.log_scales[:, [2, 0, 1]]))
    # The deviation of 900 normal numbers is 1 within four standard errors, 4 / sqrt(2 * 900).
    np.testing.assert_allclose(offsets.std(axis=0), 1, atol=0.1)


def test_gaussians_spawn_only_where_the_gradient_reaches_the_threshold(case: Case) -> None:
    counts = [len(case.train(case.trainer(spawn_gradient=g, spawn_iterations=0)).added) for g in (0, 1e-4, 1)]
    assert counts[0] > counts[1] > counts[2] == 0


def test_spawned_gaussians_step_in_units_of_the_rig(case: Case) -> None:
    """Adam's first step is the rate, whatever the gradient; the rig of these tests is 1.2 units large."""
    given = {"spawn_gradient": 0.0, "prune_opacity": 0.0, "prune_size": 1e9}
    before, after = (case.train(case.trainer(**given, spawn_iterations=n)).added for n in (0, 1))
    steps = np.abs(after.means - before.means)[(after.means != before.means).any(axis=1)]
    np.testing.assert_allclose(np.median(steps), threedgstream.RATES.means * 1.2, rtol=1e-3)


class Gathering(CpuKernel):
    """Counts the steps whose view gradients are gathered."""

    def view_gradients(self, count: int) -> Any:
        found, self.steps = super().view_gradients(count), 0

        def add(*given: Any) -> None:
            self.steps += 1
            found.add(*given)

        return SimpleNamespace(add=add, mean=found.mean)


def test_gaussians_spawn_by_the_last_20_steps_of_stage_1(case: Case) -> None:
    """As in the released code (`threedgstream`)."""
    trainer = case.trainer(cache_iterations=33)
    trainer._kernel = kernel = Gathering(2)
    case.train(trainer)
    assert kernel.steps == 20


def test_faint_or_huge_spawned_gaussians_go(case: Case) -> None:
    for change in ({"prune_opacity": 0.11}, {"prune_size": 1e-3}):
        assert len(case.train(case.trainer(spawn_gradient=0.0, spawn_iterations=0, **change)).added) == 0
    kept = case.train(case.trainer(spawn_gradient=1e-5, prune_opacity=0.0, prune_size=1e9))
    some = case.train(case.trainer(spawn_gradient=1e-5, prune_opacity=0.1))
    assert 0 < len(some.added) < len(kept.added)
    assert (some.added.opacity_logits >= np.log(0.1 / 0.9) - 1e-5).all()


def test_the_cache_begins_anew_with_every_frame(case: Case) -> None:
    trainer = case.trainer(spawn_gradient=1e9)
    assert (case.train(trainer).values.means != case.scene.means).any()
    trainer._config = replace(trainer._config, cache_iterations=0)
    np.testing.assert_array_equal(case.train(trainer).values.means, case.scene.means)


def test_rows_beyond_the_keyframes_are_dropped_before_anything_is_trained(case: Case) -> None:
    crowded = join_splats(case.scene, case.scene)
    frame, alone = case.train(case.trainer(), crowded), case.train(case.trainer())
    np.testing.assert_array_equal(frame.removed, np.arange(len(case.scene), 2 * len(case.scene)))
    assert bits(frame.values) + bits(frame.added) == bits(alone.values) + bits(alone.added)


def test_a_frame_is_trained_alike_whatever_was_trained_before(case: Case) -> None:
    trainer = case.trainer(spawn_gradient=1e-5, cache_iterations=7)  # which ends inside a round of the five views
    frames = [case.train(trainer, frame=frame) for frame in (1, 2, 1)]
    first, other, again = (bits(frame.values) + bits(frame.added) for frame in frames)
    assert first == again != other


def test_results_depend_on_the_seed_and_not_on_threads(case: Case) -> None:
    frames = [case.train(case.trainer(spawn_gradient=1e-5, **o)) for o in ({"threads": 1}, {"threads": 5}, {"seed": 1})]
    one, five, other = (bits(frame.values) + bits(frame.added) for frame in frames)
    assert one == five != other


def test_a_loss_that_is_not_finite_names_the_camera(case: Case) -> None:
    pictures = [*case.pictures[:4], np.full_like(case.pictures[4], np.nan)]
    with pytest.raises(TrainingError, match="the loss of camera cam04 is nan"):
        case.train(case.trainer(), pictures=pictures)


# The stream


def test_every_frame_is_trained_whole_and_spawned_gaussians_last_one_frame(dense: Any, moving: Any) -> None:
    with open_stream(dense.path) as stream:
        frames = list(stream.frames())
    # Frame 2 shows what frame 1 does: the pictures do not change, and still it is trained.
    assert [PacketKind(frame.kind).name for frame in frames] == ["KEY", "DELTA", "DELTA", "DELTA"]
    assert [frame.selected for frame in dense.report.frames] == [1, 1, 1, 1]
    base = frames[0].state.ids
    np.testing.assert_array_equal(base, moving.states[0].ids)
    for before, frame in pairwise(frames):
        spawned = frame.state.ids[len(base) :]
        assert len(spawned) > 0
        np.testing.assert_array_equal(frame.state.ids[: len(base)], base)
        assert (spawned >= before.state.next_id).all(), "none of them is of the frame before"
        assert frame.changes.removed == len(before.state) - len(base)
        for name in ("log_scales", "opacity_logits", "sh"):
            lasting = getattr(frame.state, name)[: len(base)]
            np.testing.assert_array_equal(lasting, getattr(frames[0].state, name))


def test_reconstruction_equals_the_decoders_after_every_packet(dense: Any) -> None:
    with open_stream(dense.path) as stream:
        frames = list(stream.frames())
    assert [digest(frame.state) for frame in frames] == [digest(state) for state in dense.states]


def test_no_mask_is_made_and_nothing_selected(dense: Any, moving: Any) -> None:
    stages = {"masks", "selection"}
    assert all(stages <= frame.seconds.keys() for frame in (moving.report.frames[1], moving.report.frames[3]))
    assert not any(stages & frame.seconds.keys() for frame in dense.report.frames)


def test_the_held_out_camera_never_reaches_training(
    dense: Any, encode: Any, moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    run: Callable[[str], Any] = lambda name: encode(  # noqa: E731
        tiny_rig.poisoned(moving_rig, tmp_path / name, name),
        settings=replace(tiny_settings, method="3dgstream"),
        keyframe=moving.path,
    )
    assert run(tiny_rig.held_out).data == dense.data
    assert run("cam00").data != dense.data
