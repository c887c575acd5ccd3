"""Cuts: another scene gets a keyframe of its own, and nothing that the light does is taken for one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import decogs.encoder.coding.scene as coding_scene
import decogs.encoder.frame.encode_frame as encode_frame
import decogs.encoder.stream.encoder as stream_encoder
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import render
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import EncodeSettings
from decogs.encoder.change.cuts import shows_another_scene
from decogs.encoder.settings.effects import CorrectionSettings
from decogs.formats.errors import TrainingError
from decogs.formats.splats import join_splats
from decogs.formats.stream.container import PacketKind


def picture(seed: int, *, noise: float = 0.0) -> np.ndarray:
    """(3, 120, 160): patches and lines, with noise in 8-bit levels."""
    random = np.random.default_rng(seed)
    canvas = np.full((120, 160, 3), 90.0)
    for _ in range(60):
        corner, size = random.integers(0, 150, 2), random.integers(4, 40, 2)
        canvas[corner[1] : corner[1] + size[1], corner[0] : corner[0] + size[0]] = random.uniform(20, 230, 3)
    return noisy(canvas.transpose(2, 0, 1) / 255, noise, seed)


def noisy(planes: np.ndarray, noise: float, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(100 + seed)
    recorded = np.rint(255 * planes + random.normal(0, noise, planes.shape)) / 255
    return np.clip(recorded, 0, 1).astype(np.float32)


def lit(planes: np.ndarray, gain: float) -> np.ndarray:
    """The same picture under ``gain`` times the light, as a camera codes it."""
    return (np.minimum(planes**2.2 * gain, 1) ** (1 / 2.2)).astype(np.float32)


@pytest.mark.parametrize("times", [1, 5])
def test_other_pictures_are_another_scene(times: int) -> None:
    """Whatever their size."""
    seeds = ((1, 2, 3), (4, 5, 6))
    now, before = ([picture(seed, noise=1.2).repeat(times, 1).repeat(times, 2) for seed in each] for each in seeds)
    assert not shows_another_scene(before, before)
    assert shows_another_scene(now, before)
    assert shows_another_scene([each[:, ::-1].copy() for each in before], before), "turned upside down"
    assert not shows_another_scene([], [])


@pytest.mark.parametrize("gain", [0.05, 0.1, 0.5, 2, 4, 16])
def test_light_is_no_other_scene(gain: float) -> None:
    before = [picture(seed, noise=1.2) for seed in (1, 2, 3)]
    assert not shows_another_scene([noisy(lit(each, gain), 1.2, 9) for each in before], before)


def test_one_camera_that_was_turned_is_no_other_scene() -> None:
    before = [picture(seed, noise=1.2) for seed in (1, 2, 3)]
    assert not shows_another_scene([before[0][:, ::-1].copy(), *before[1:]], before)


def test_what_shows_nothing_is_no_other_scene() -> None:
    before = [picture(seed, noise=1.2) for seed in (1, 2, 3)]
    dark = [noisy(np.full_like(each, 0.1), 3.0, number) for number, each in enumerate(before)]
    assert not shows_another_scene(dark, before)


@pytest.fixture(scope="module")
def cut_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of one scene, then two of another one: other walls, other things, as no motion could bring them."""
    folder = tiny_rig.write(tmp_path_factory.mktemp("cut") / "rig", noise=1.2)
    random = np.random.default_rng(3)
    for frame in (2, 3):
        other = join_splats(
            tiny_rig.patch((0, 0, 0.4), 40, 24, 0.15, 21), tiny_rig.patch((0.1 * frame - 0.5, 0, -0.3), 4, 4, 0.1, 22)
        )
        for index in range(tiny_rig.cameras):
            camera = tiny_rig.camera(index)
            clean = to_8bit(render(other, camera, threads=1).image)
            seen = np.clip(np.rint(clean + random.normal(0, 1.2, clean.shape)), 0, 255).astype(np.uint8)
            tiny_rig.write_png(folder / camera.name / f"{frame:04d}.png", seen)
    return folder


def check_decoded(encoded: Any) -> list[PacketKind]:
    """The decoder has the encoder's states, from the start and from every keyframe on; the packets' kinds."""
    expected = [digest(state) for state in encoded.states]
    with open_stream(encoded.path) as stream:
        assert stream.complete
        frames = list(stream.frames())
        assert [digest(frame.state) for frame in frames] == expected
        for first in range(len(expected)):
            assert digest(next(iter(stream.frames(first))).state) == expected[first], first
    return [report.kind for report in encoded.report.frames]


def uncut(settings: EncodeSettings) -> EncodeSettings:
    """With a time for each frame, more than any takes, within which no keyframe is trained."""
    return replace(settings, time_budget=1e4)


def test_another_scene_gets_a_keyframe(cut_rig: Path, encode: Any, tiny_settings: Any) -> None:
    steps: list[int] = []
    settings = replace(tiny_settings, keyframe=replace(tiny_settings.keyframe, iterations=200))
    cut = encode(cut_rig, settings=settings, on_keyframe_step=lambda step, steps_, loss: steps.append(step))
    assert check_decoded(cut) == ["key", "delta", "key", "delta"]
    assert [report.cut for report in cut.report.frames] == [False, False, True, False]
    assert steps.count(1) == 2, "the progress of both keyframes is told"
    before, after = cut.states[1], cut.states[2]
    assert int(after.ids[0]) == before.next_id, "no Gaussian of the former scene is left, and no id is given twice"
    kept = encode(cut_rig, settings=uncut(settings), keyframe=cut.path)
    assert check_decoded(kept)[2] == "delta"
    gain = [
        one.held_out_psnr - other.held_out_psnr
        for one, other in zip(cut.report.frames, kept.report.frames, strict=True)
    ]
    assert gain[0] == gain[1] == 0
    assert min(gain[2:]) > 1, gain


@pytest.mark.parametrize("drifting", [(), pytest.param(("cam01",), marks=pytest.mark.slow)])
def test_an_encode_with_a_cut_is_resumed_to_the_same_bytes(
    cut_rig: Path, encode: Any, tiny_settings: Any, tmp_path: Path, drifting: tuple[str, ...]
) -> None:
    """Also where a camera's exposure and pose are compensated, which the packets hold."""
    corrections = CorrectionSettings(exposure=drifting, shake=drifting)
    settings = replace(tiny_settings, corrections=corrections)
    whole = encode(cut_rig, settings=settings)
    assert whole.report.frames[2].cut
    check_decoded(whole)
    for frames in (2, 3, 4):
        path = tmp_path / f"{frames}.dgs"
        path.with_name(f"{path.name}.part").write_bytes(whole.cut_off(frames))
        assert encode(cut_rig, settings=settings, output=path, resume=True).data == whole.data, frames


def test_a_replayed_packet_is_decoded_once(
    cut_rig: Path, encode: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, decoded = encode(cut_rig), list[int]()

    def noted(before: Any, packet: Any, *header: Any, **first: Any) -> Any:
        decoded.append(packet.frame)
        return reconstruct(before, packet, *header, **first)

    for module in (coding_scene, encode_frame, stream_encoder):
        monkeypatch.setattr(module, "reconstruct", noted)
    path = tmp_path / "resumed.dgs"
    path.with_name(f"{path.name}.part").write_bytes(whole.cut_off(3))
    assert encode(cut_rig, output=path, resume=True).data == whole.data
    assert decoded == [0, 1, 2, 3]


@pytest.mark.parametrize("closed", [False, True])
def test_a_cut_inside_and_at_the_start_of_segments(
    cut_rig: Path, encode: Any, tiny_settings: Any, closed: bool
) -> None:
    """The first closed segment after the cut starts from its keyframe."""
    settings = replace(tiny_settings, segment=3, closed=closed)
    encoded = encode(cut_rig, settings=settings)
    assert check_decoded(encoded)[2:] == ["key", "key"]
    assert [report.cut for report in encoded.report.frames] == [False, False, True, False]


def test_no_keyframe_is_trained_within_a_time_budget(cut_rig: Path, encode: Any, tiny_settings: Any) -> None:
    encoded = encode(cut_rig, settings=replace(tiny_settings, time_budget=5.0))
    assert [report.cut for report in encoded.report.frames] == [False] * 4


def test_a_cut_that_cannot_be_a_keyframe_is_trained_as_other_frames_are(
    cut_rig: Path, encode: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    begun: list[int] = []

    def fails_the_second_time(step: int, steps: int, loss: float) -> None:
        begun.extend([step] * (step == 1))
        if len(begun) > 1:
            raise TrainingError("no number")

    encoded = encode(cut_rig, on_keyframe_step=fails_the_second_time)
    assert len(begun) == 2
    assert check_decoded(encoded)[2] == "delta"
    path = tmp_path / "left.dgs"
    path.with_name(f"{path.name}.part").write_bytes(encoded.cut_off(3))
    assert encode(cut_rig, output=path, resume=True).data == encoded.data
    kept = encode(cut_rig, settings=uncut(tiny_settings))
    assert [digest(state) for state in encoded.states] == [digest(state) for state in kept.states]


def test_a_cut_in_which_a_camera_fails_waits_for_no_keyframe(cut_rig: Path, encode: Any, tmp_path: Path) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(cut_rig, rig)
    seen = cv2.imread(str(rig / "cam01" / "0002.png"))
    assert cv2.imwrite(str(rig / "cam01" / "0002.png"), 0 * seen)
    encoded = encode(rig)
    assert encoded.report.frames[2].left_out
    assert check_decoded(encoded)[2] == "delta"


def test_a_camera_that_shows_another_scene_alone_is_no_cut(cut_rig: Path, encode: Any, tmp_path: Path) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(cut_rig, rig)
    for camera in ("cam00", "cam01", "cam03"):
        for frame in (2, 3):
            assert cv2.imwrite(str(rig / camera / f"{frame:04d}.png"), cv2.imread(str(rig / camera / "0001.png")))
    assert not any(report.cut for report in encode(rig).report.frames)
