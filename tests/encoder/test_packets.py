"""Packets from what a frame changes: which kind it is, what it holds, and what its bytes are for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.codec.packets.corrections import CorrectedCameras, Correction
from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.syntax import refers_to_first
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import default_lattice, dequantise, quantise
from decogs.encoder.coding.packets import Written, frame_packet, key_packet, read_back
from decogs.encoder.coding.scene import Scene
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.encoder.training.method import TrainedFrame
from decogs.formats.splats import Splats, empty_splats, take_splats
from decogs.formats.stream.container import PacketKind

COUNT = 400
CORRECTED = CorrectedCameras(exposure_drift=("cam01",))
DARK = {"cam01": Correction(exposure=-300)}
NOBODY, ALL, SOME = np.zeros(0, np.int64), np.arange(COUNT), np.arange(0, COUNT, 7)


def splats_of(seed: int) -> Splats:
    random = np.random.default_rng(seed)
    shapes = ((COUNT, 3), (COUNT, 3), (COUNT, 4), (COUNT,), (COUNT, 4, 3))
    return Splats(*(random.normal(size=shape).astype(np.float32) for shape in shapes))


def scene_of(corrected: CorrectedCameras = CORRECTED) -> Scene:
    lattice = default_lattice(1.0)
    header: Any = SimpleNamespace(lattice=lattice, corrected=corrected, coefficients=4)
    state = new_state(quantise(splats_of(1), lattice))
    return Scene(header, state, state, dequantise(state, lattice))


SCENE = scene_of()


def trained(kept: np.ndarray = NOBODY, removed: np.ndarray = NOBODY, *, added: bool = False) -> TrainedFrame:
    """The rows ``kept`` stand somewhere else, those ``removed`` are gone, one like the first comes."""
    values = take_splats(SCENE.splats, kept)
    values.means[:] += np.random.default_rng(2).normal(0, 0.01, values.means.shape)
    return TrainedFrame(kept, values, removed, take_splats(SCENE.splats, ALL[:1]) if added else empty_splats(1))


def written(frame: int, change: TrainedFrame | None, **options: Any) -> Written:
    scene, corrections = options.pop("scene", SCENE), options.pop("corrections", DARK)
    return frame_packet(scene, frame, change, SignificanceSettings(), corrections, **options)


@pytest.mark.parametrize(
    ("change", "kind", "gaussians"),
    [
        (None, PacketKind.SKIP, COUNT),
        (trained(), PacketKind.SKIP, COUNT),
        (replace(trained(SOME), values=take_splats(SCENE.splats, SOME)), PacketKind.SKIP, COUNT),
        (trained(SOME), PacketKind.DELTA, COUNT),
        (trained(removed=SOME), PacketKind.DELTA, COUNT - len(SOME)),
        (trained(added=True), PacketKind.DELTA, COUNT + 1),
    ],
    ids=["nothing", "no rows", "the same values", "moved", "removed", "added"],
)
def test_a_frame_is_a_delta_where_anything_changes_comes_or_goes(
    change: TrainedFrame | None, kind: PacketKind, gaussians: int
) -> None:
    packet = written(1, change).packet
    assert packet.kind == kind
    assert len(SCENE.read(packet)) == gaussians


def test_a_segment_begins_with_a_keyframe_that_refers_to_the_first() -> None:
    """So does a frame after a flash. They hold what a delta would lead to, and nothing, where nothing changed."""
    for change in (None, trained(SOME)):
        kinds = [written(frame, change, segment=3).packet.kind == PacketKind.KEY for frame in range(1, 7)]
        assert kinds == [False, False, True, False, False, True]
        delta = SCENE.read(written(1, change).packet)
        for key in (written(3, change, segment=3), written(1, change, whole=True)):
            assert refers_to_first(replace(key.packet, start=CORRECTED.block_bytes))
            before = replace(SCENE, state=replace(SCENE.state, frame=key.packet.frame - 1))
            assert digest(before.read(key.packet)) == digest(replace(delta, frame=key.packet.frame))


@pytest.mark.parametrize("change", [None, trained(SOME)], ids=["skip", "delta"])
@pytest.mark.parametrize("corrected", [CORRECTED, CorrectedCameras()], ids=["corrected", "as recorded"])
def test_costs_are_all_of_a_payload_and_can_be_read_back(
    change: TrainedFrame | None, corrected: CorrectedCameras
) -> None:
    scene, corrections = scene_of(corrected), DARK if corrected.effects else {}
    first = key_packet(scene.header, scene.state, corrections)
    for each in (first, written(1, change, scene=scene, corrections=corrections)):
        assert sum(each.costs.values()) == len(each.packet.payload)
        assert each.costs.get("corrections", 0) == corrected.block_bytes
        assert read_back(each.packet, scene.header) == (each, corrections)
