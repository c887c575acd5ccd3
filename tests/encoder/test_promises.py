"""What the encoder's documents promise and no other test would miss: one short test for each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import decogs.encoder.keyframe.train as keyframe
from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice, dequantise
from decogs.codec.scene.state import take_rows
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.coding.changes import delta_of
from decogs.encoder.frame.commit import next_memory
from decogs.encoder.frame.events import PendingFrame
from decogs.encoder.frame.memory import Memory
from decogs.encoder.frame.plan import FramePlan
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.settings.frame import EmergenceSettings, SignificanceSettings
from decogs.encoder.settings.presets import preset
from decogs.encoder.stopwatch import Stopwatch
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame, TrainingContext
from decogs.encoder.training.seeding import _confirm, _Seeds
from decogs.formats.splats import Splats, empty_splats, take_splats
from noting_kernel import NotingKernel
from packets import iterate_packets


def header_of(path: Path) -> StreamHeader:
    with open_stream(path) as stream:
        return stream.header


# Growth


@pytest.mark.parametrize("growth", [1.25, 1.02])
def test_a_scene_grows_no_further_than_the_stream_allows(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any, growth: float
) -> None:
    """STABILITY.md: clones and splits of later frames stop at 1.25 times the keyframe's Gaussians."""
    most = round(growth * len(moving.states[0]))

    def eager(given: TrainingContext) -> DecogsTrainer:
        assert given.max_gaussians == round(1.25 * given.population)
        return DecogsTrainer(replace(given, grow_gradient=0.0, max_gaussians=most))

    frame = replace(tiny_settings.frame, emergence=EmergenceSettings(max_seeds=0), grow_fraction=1.0)
    encoded = encode(
        moving_rig,
        settings=replace(tiny_settings, frame=frame),
        keyframe=moving.path,
        context=lambda context: replace(context, method=FrameMethod(eager)),
    )
    assert 1.02 * len(moving.states[0]) - 1 < max(map(len, encoded.states)) <= most


# The header


def test_a_distorted_rig_says_so_in_its_header(encode: Any, lens_rig: Path, moving: Any) -> None:
    """SPEC.md, "Header packet": a decoder that does not know the effect must not show the stream."""
    assert "lens_distortion" in header_of(encode(lens_rig, stop=1).path).effects
    assert "lens_distortion" not in header_of(moving.path).effects


# Rotations


def test_the_largest_component_of_a_keyframes_rotations_is_one() -> None:
    """However little a rotation shows: without it, nothing would say which way the Gaussian is turned."""
    splats = Splats(*(np.zeros((10, *shape), np.float32) for shape in ((3,), (3,), (4,), (), (1, 3))))
    splats.quaternions[:, 0] = 1
    splats.quaternions[9] = [0.1, -0.9, 0.2, 0.3]
    optimiser = SimpleNamespace(splats=splats, gradient_size=lambda name: np.zeros_like(getattr(splats, name)))
    stub: Any = SimpleNamespace(
        _optimiser=optimiser, _settings=SimpleNamespace(rd_lambda=1.0), _losses=[SimpleNamespace(emphasis=1e6)]
    )
    lattice = default_lattice(1.0)
    one, judged = round(1 / lattice.quaternions), keyframe._KeyframeTraining._rd_quantised(stub, lattice).quaternions
    np.testing.assert_array_equal(judged[:9], [[one, 0, 0, 0]] * 9)
    np.testing.assert_array_equal(judged[9, 1:], [one, 0, 0], "not the commonest, 0")


def test_a_delta_keeps_the_quaternions_that_turn_alike(moving: Any) -> None:
    """The same rotation has quaternions of any length and both signs: a delta tells none of them."""
    state, lattice = moving.states[0], header_of(moving.path).lattice
    state = replace(state, quaternions=-state.quaternions)  # as a frame in between may have left them
    rows = np.arange(len(state))
    values = dequantise(take_rows(state, rows), lattice)
    scale = np.where(rows % 2, -3.0, 0.5).astype(np.float32)[:, None]
    trained = TrainedFrame(
        rows,
        replace(values, quaternions=values.quaternions * scale),
        np.zeros(0, np.int64),
        empty_splats(values.sh_degree),
    )
    assert len(delta_of(state, lattice, trained, SignificanceSettings()).rows) == 0


# Rates


def test_rates_fall_over_the_second_half_of_a_frame(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    kernel, steps = NotingKernel(), 20
    frame = replace(tiny_settings.frame, joint_iterations=steps)
    encode(moving_rig, settings=replace(tiny_settings, frame=frame), keyframe=moving.path, stop=2, kernel=kernel)
    rates = np.array([given.log_scales for given in kernel.rates])
    expected = [0.2 ** max(0.0, 2 * done / steps - 1) for done in range(steps)]
    np.testing.assert_allclose(rates / rates[0], expected, rtol=1e-6)


# What a frame leaves behind


@pytest.mark.parametrize("effects", [("appearance_change",), ("motion", "appearance_change")])
@pytest.mark.parametrize("changed", [True, False])
def test_the_masks_remember_what_was_trained_and_whether_it_moved(
    moving: Any, effects: tuple[str, ...], changed: bool
) -> None:
    """Light alone is not remembered as motion: the faint light around it counts in the next frame."""
    told: list[bool] = []
    state = moving.states[0]

    def trained(*_: Any, moved: bool, **__: Any) -> Any:
        told.append(moved)
        return masks

    masks: Any = SimpleNamespace(trained=trained, advance=lambda *_, **__: masks)
    stub: Any = SimpleNamespace
    memory = Memory(stub(), masks, None, None, None, stub())
    before: Any = stub(state=state, splats=None, header=stub(first_frame=0))
    after: Any = stub(
        state=replace(state, frame=1, sh=state.sh + 1) if changed else replace(state, frame=1),
        splats=None,
    )
    context = stub(settings=preset("draft"), corrector=None, threads=1)
    plan = FramePlan([stub(dilated=None)], np.ones(3, bool), effects, preset("draft").frame)
    shown: Any = stub(training=[], index=1)
    frame = PendingFrame(shown, shown, {}, before, memory)
    next_memory(context, frame, plan, after, stub(truncated=False), stub(), Stopwatch())
    assert told == (["motion" in effects] if changed else [])


def unchanged(frame: FrameInput) -> TrainedFrame:
    """A frame whose training diverged."""
    rows, none = np.flatnonzero(frame.selected), empty_splats(frame.scene.sh_degree)
    return TrainedFrame(rows, take_splats(frame.scene, rows), np.zeros(0, np.int64), none, rejected=True)


def test_a_frame_that_was_given_up_is_tried_again_also_after_a_resume(
    encode: Any,
    moving: Any,
    moving_rig: Path,
    tiny_settings: Any,
    tmp_path: Path,
) -> None:
    """Frame 2 shows what frame 1 did: had frame 1 counted as trained, the miss would be there for good."""

    class RunsAway(DecogsTrainer):
        def train(self, frame: FrameInput, /) -> TrainedFrame:
            trained = super().train(frame)
            return trained if frame.index > 1 else unchanged(frame)

    masks = replace(tiny_settings.frame.masks, since_trained=True)
    given = {"settings": replace(tiny_settings, frame=replace(tiny_settings.frame, masks=masks))}
    given |= {"keyframe": moving.path, "context": lambda context: replace(context, method=FrameMethod(RunsAway))}
    encoded = encode(moving_rig, **given)
    assert [frame.kind for frame in encoded.report.frames] == ["key", "skip", "delta", "delta"]
    assert [frame.rejected for frame in encoded.report.frames] == [False, True, False, False]
    with encoded.path.open("rb") as file:
        whole = [packet.offset + packet.size for packet in iterate_packets(file)]
    (tmp_path / "x.dgs.part").write_bytes(encoded.data[: whole[2]])
    resumed = encode(moving_rig, output=tmp_path / "x.dgs", resume=True, **given)
    assert (resumed.data, resumed.report.resumed) == (encoded.data, 2)


# New objects


def test_a_seed_needs_a_second_view_that_ends_there_as_well() -> None:
    random = np.random.default_rng(2)
    both, alone = random.uniform(0, 0.001, (20, 3)), random.uniform(5, 5.001, (20, 3))

    points = np.concatenate([both[:10], alone, both[10:]])
    views = np.repeat([0, 1], [30, 10])
    count = len(points)
    kept = _confirm(
        _Seeds(points, views, np.zeros((count, 3), np.float32), np.full(count, 0.01), np.zeros(count, np.float32)), 1
    )
    assert sorted(map(tuple, kept.points)) == sorted(map(tuple, both))
