"""Ablations: what is left of a method without its selection, its focus loss or its gate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.bench.methods.ablations import DECOGS, PAPER
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.change.selection import SELECTION_RULES
from decogs.encoder.job.switches import ablate
from decogs.encoder.methods import FRAME_METHODS, method_of
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.frame import EmergenceSettings, FrameSettings
from decogs.encoder.training.method import FrameMethod, FrameTrainer
from decogs.formats.errors import UsageError
from one_frame import BOX, Case, bits, moved_square, train, training_context

SETTINGS = FrameSettings(joint_iterations=30, grow_fraction=0.0, emergence=EmergenceSettings(max_seeds=0))
METHODS = pytest.mark.parametrize("method", [DECOGS, PAPER], ids=["decogs", "paper"])


@pytest.fixture(scope="module")
def case(moving_rig: Path, tiny_rig: Any) -> Case:
    return moved_square(moving_rig, tiny_rig)


def ablated(case: Case, method: FrameMethod, *parts: str, **settings: Any) -> tuple[FrameTrainer, FrameSettings]:
    frame, kernel = replace(SETTINGS, ablated=parts, **settings), CpuKernel(2)
    whole = EncodeSettings(frame=frame)
    context = training_context(kernel, case.ingest.views, case.static_views(kernel), settings=whole, box=BOX)
    return method.trainer(context), frame


def given(case: Case, *, everywhere: bool = True) -> tuple[Any, ...]:
    masks = case.masks(everywhere=everywhere)
    return case.scene, case.selected, case.pictures, masks


def test_they_are_offered_as_a_package_offers_its_own() -> None:
    assert {"decogs-ablated", "paper-ablated"} <= set(FRAME_METHODS.names())
    assert "all" in SELECTION_RULES.names()
    for name in ("decogs", "paper"):
        settings = ablate(EncodeSettings(method=name), ["gate"])
        assert method_of(settings) is FRAME_METHODS.get(f"{name}-ablated")
    with pytest.raises(UsageError, match="`ablate` gate: `method` mine has no such part; drop one of the two"):
        method_of(ablate(EncodeSettings(method="mine"), ["gate"]))


@METHODS
def test_without_the_gate_everything_moves_and_momentum_lasts(case: Case, method: FrameMethod) -> None:
    results = []
    for lasts in (True, False):
        trainer, settings = ablated(case, method, "gate")
        frame = train(trainer, *given(case), frame=1, settings=settings)
        np.testing.assert_array_equal(frame.kept, np.arange(len(case.scene)))
        moved = (frame.values.means != case.scene.means).any(axis=1)
        assert moved[~case.selected].mean() > 0.8  # the wall reaches a little beyond what the cameras see
        if not lasts:
            trainer, _ = ablated(case, method, "gate")
        for view in trainer.context.static_views:  # type: ignore[attr-defined]
            view.set_scene(case.scene)
        results.append(bits(train(trainer, *given(case), frame=2, settings=settings).values))
    assert results[0] != results[1]


@METHODS
def test_without_the_gate_what_is_selected_grows_alone(case: Case, method: FrameMethod) -> None:
    eager = replace(method, trainer=lambda context: method.trainer(replace(context, grow_gradient=0.0)))
    trainer, settings = ablated(case, eager, "gate", grow_fraction=1.0, prune_opacity=0.0)
    assert 0 < len(train(trainer, *given(case), frame=1, settings=settings).added) <= case.selected.sum()


@METHODS
def test_without_the_focus_the_masks_are_not_in_the_loss(case: Case, method: FrameMethod) -> None:
    def values(everywhere: bool, *parts: str) -> bytes:
        trainer, settings = ablated(case, method, *parts)
        masks = given(case, everywhere=everywhere)
        return bits(train(trainer, *masks, frame=1, settings=settings).values)

    assert values(True, "focus") == values(False, "focus")
    assert values(True) != values(False)


def test_without_the_selection_all_are_trained_where_pictures_changed(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    encoded = encode(moving_rig, settings=ablate(tiny_settings, ["select"]), keyframe=moving.path)
    assert [frame.selected for frame in encoded.report.frames] == [1, 1, 0, 1]
    assert [frame.kind for frame in encoded.report.frames] == ["key", "delta", "skip", "delta"]
    with open_stream(encoded.path) as ablated, open_stream(moving.path) as whole:
        counts = [next(stream.frames(1, 2)).changes.touched for stream in (ablated, whole)]
    # Almost all move: only a change of less than half a lattice step is none.
    assert counts[0] > 0.9 * len(encoded.states[0]) > 2 * counts[1]
