"""The closed loop: what reaches training, what a frame may change, and that encoder and decoder hold the same bits.

The method's promise and the equality of both sides are tested on whole encodes, seen from outside: the encoder's own
states and selections are noted while it works (conftest.py), the rest is read back by the decoder.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.packets.corrections import Correction
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import dequantise
from decogs.decoder.commands import decode_main
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import PRESETS
from decogs.encoder.frame.context import Context
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.settings.frame import MaskSettings, SelectionSettings
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame
from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.rigs import open_rig
from decogs.formats.stream.container import PacketKind, StreamWriter
from decogs.formats.system.kernels import INSTRUCTION_SETS, best_instruction_set
from decogs.rig.pictures.ingest import frame_span
from noting_kernel import NotingKernel

ATTRIBUTES = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


def decoded(path: Path) -> list[DecodedFrame]:
    with open_stream(path) as stream:
        assert stream.complete
        return list(stream.frames())


def kinds(frames: list[DecodedFrame]) -> list[str]:
    return [PacketKind(frame.kind).name for frame in frames]


def bits_by_id(frame: DecodedFrame) -> dict[int, bytes]:
    """Every Gaussian's exact lattice integers and stored floats."""
    columns = [getattr(source, name) for source in (frame.state, frame.splats) for name in ATTRIBUTES]
    return {int(i): b"".join(c[row].tobytes() for c in columns) for row, i in enumerate(frame.state.ids)}


def check_promise(frames: list[DecodedFrame], selected: dict[int, np.ndarray]) -> None:
    for frame, before, after in zip(range(1, len(frames)), frames, frames[1:], strict=False):
        chosen = selected.get(frame, np.zeros(len(before.state), bool))
        assert len(chosen) == len(before.state)
        old, new = bits_by_id(before), bits_by_id(after)
        for i in before.state.ids[~chosen]:
            assert new[int(i)] == old[int(i)], f"frame {frame}: Gaussian {i} is not in S_t, but changed"


# What reaches training


def test_the_held_out_camera_never_reaches_training(
    moving: Any, encode: Any, moving_rig: Path, tiny_rig: Any, tmp_path: Path
) -> None:
    poisoned = encode(tiny_rig.poisoned(moving_rig, tmp_path / "rig", tiny_rig.held_out))
    assert poisoned.data == moving.data
    # It is measured on, though: the poison is there, and seen.
    for clean, dirty in zip(moving.report.frames, poisoned.report.frames, strict=True):
        assert dirty.held_out_psnr < clean.held_out_psnr - 3
        assert dirty.training_psnr == clean.training_psnr


def test_every_training_camera_does(moving: Any, encode: Any, moving_rig: Path, tiny_rig: Any, tmp_path: Path) -> None:
    for name in ("cam00", "cam03"):
        assert encode(tiny_rig.poisoned(moving_rig, tmp_path / name, name)).data != moving.data


def test_without_held_out_cameras_there_is_no_held_out_psnr(encode: Any, moving_rig: Path, moving: Any) -> None:
    alone = encode(moving_rig, holdout=[], stop=1)
    assert alone.report.frames[0].held_out_psnr is None
    assert moving.report.frames[0].held_out_psnr is not None


# The method's promise


def test_gaussians_not_selected_are_bit_identical_before_and_after(moving: Any) -> None:
    frames = decoded(moving.path)
    assert kinds(frames) == ["KEY", "DELTA", "SKIP", "DELTA"]
    assert sorted(moving.selected) == [1, 3]
    check_promise(frames, moving.selected)
    for frame, chosen in moving.selected.items():
        assert 0 < chosen.sum() < len(chosen), "a strict, non-empty part, or the test says nothing"
        before, after = bits_by_id(frames[frame - 1]), bits_by_id(frames[frame])
        ids = frames[frame - 1].state.ids[chosen]
        changed = [i for i in ids if after.get(int(i)) != before[int(i)]]
        assert len(changed) > len(ids) / 2, "and the selected do change"
        assert frames[frame].changes.touched <= chosen.sum()
    assert frames[3].changes.added > 0


def test_the_promise_holds_with_the_papers_selection_removals_and_no_cache(
    encode: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    frame = replace(
        tiny_settings.frame,
        selection=SelectionSettings(rule="paper"),
        joint_iterations=20,
        prune_opacity=0.12,
        grow_fraction=0.3,
    )
    encoded = encode(moving_rig, settings=replace(tiny_settings, frame=frame), holdout=[])
    frames = decoded(encoded.path)
    check_promise(frames, encoded.selected)
    assert sum(frame.changes.removed for frame in frames[1:]) > 0
    assert all(0 < chosen.sum() < len(chosen) for chosen in encoded.selected.values())


def test_a_change_that_one_view_alone_shows_selects_nothing(encode: Any, tiny_rig: Any, tmp_path: Path) -> None:
    rig = tiny_rig.write(tmp_path / "rig", frames=[0, 0])
    path = rig / "cam01" / "0001.png"
    picture = cv2.imread(str(path))
    picture[10:30, 20:40] = 255 - picture[10:30, 20:40]
    cv2.imwrite(str(path), picture)
    encoded = encode(rig)
    assert not encoded.selected[1].any()
    assert kinds(decoded(encoded.path)) == ["KEY", "SKIP"]


def test_new_gaussians_get_new_ids(moving: Any) -> None:
    for before, after in zip(moving.states, moving.states[1:], strict=False):
        added = after.ids[~np.isin(after.ids, before.ids)]
        assert (added >= before.next_id).all()
        assert after.next_id == before.next_id + len(added)
    assert moving.states[-1].next_id > moving.states[0].next_id
    assert [frame.gaussians for frame in moving.report.frames] == [len(state) for state in moving.states]


# Encoder and decoder


@pytest.mark.parametrize("stream", ["moving", "still"])
def test_reconstruction_equals_the_decoders_after_every_packet(stream: str, request: pytest.FixtureRequest) -> None:
    encoded = request.getfixturevalue(stream)
    frames = decoded(encoded.path)
    assert len(frames) == len(encoded.states) == 4
    for frame, state in zip(frames, encoded.states, strict=True):
        assert digest(frame.state) == digest(state)
        for name in (*ATTRIBUTES, "ids"):
            np.testing.assert_array_equal(getattr(frame.state, name), getattr(state, name))
        assert frame.state.next_id == state.next_id


@pytest.mark.parametrize("view", ["cam02", "cam04"])
def test_decoded_pictures_are_the_encoders_preview(moving: Any, tmp_path: Path, view: str) -> None:
    check_preview(moving, tmp_path, view)


def test_decoded_pictures_are_the_encoders_preview_through_a_lens(
    encode: Any, lens_rig: Path, tmp_path: Path, tiny_rig: Any
) -> None:
    check_preview(encode(lens_rig), tmp_path, "cam01")
    assert read_png(tmp_path / "out" / "cam01_000000.png").shape == (tiny_rig.height, tiny_rig.width, 3)


def check_preview(encoded: Any, tmp_path: Path, view: str) -> None:
    assert decode_main([str(encoded.path), "--view", view, "-o", str(tmp_path / "out")]) == 0
    with open_stream(encoded.path) as stream:
        header = stream.header
    for index, state in enumerate(encoded.states):
        preview = to_8bit(render_view(header, dequantise(state, header.lattice), view).image)
        np.testing.assert_array_equal(read_png(tmp_path / "out" / f"{view}_{index:06d}.png"), preview)


def read_png(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]


def test_reports_agree_with_the_stream(moving: Any) -> None:
    frames = decoded(moving.path)
    assert [report.bytes for report in moving.report.frames] == [frame.packet_bytes for frame in frames]
    assert [report.kind.upper() for report in moving.report.frames] == kinds(frames)
    assert [report.costs for report in moving.report.frames] == [frame.costs for frame in frames]
    assert moving.report.total_bytes == len(moving.data)
    shares = [1.0, *(float(moving.selected[i].mean()) if i in moving.selected else 0.0 for i in (1, 2, 3))]
    assert [report.selected for report in moving.report.frames] == shares
    for report in moving.report.frames:
        assert all(seconds >= 0 for seconds in report.seconds.values())
    assert set(moving.report.frames[0].seconds) == {"first_points", "keyframe", "write", "commit", "measure"}
    assert set(moving.report.frames[1].seconds) == {"masks", "selection", "training", "write", "commit", "measure"}
    assert not moving.report.interrupted


def test_a_lost_picture_is_named_and_no_part_of_the_quality(
    moving: Any, encode: Any, moving_rig: Path, tmp_path: Path
) -> None:
    """Frame 2 shows what frame 1 does, but for a camera that is black."""
    rig = Path(shutil.copytree(moving_rig, tmp_path / "rig"))
    black = rig / "cam01" / "0002.png"
    assert cv2.imwrite(str(black), 0 * cv2.imread(str(black)))
    before, after = encode(rig, stop=3, keyframe=moving.path).report.frames[1:]
    assert list(after.left_out) == ["cam01"]
    # The three others' mean is 0.6 dB from that of all; a black one among them would take 4 off.
    assert after.training_psnr == pytest.approx(before.training_psnr, abs=2)


def test_processor_seconds_are_those_of_the_frame_without_the_measuring(
    encode: Any, moving_rig: Path, moving: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that pictures move: each one drawn in training by a second, one rendered to be measured by 1000."""
    kernel, drawn = NotingKernel(), [0]
    monkeypatch.setattr(time, "process_time", lambda: kernel.times["draw"] + 1000 * kernel.rendered.total())
    frames = encode(
        moving_rig, keyframe=moving.path, kernel=kernel, on_frame=lambda _: drawn.append(kernel.times["draw"])
    ).report.frames
    assert [frame.kind for frame in frames] == ["key", "delta", "skip", "delta"]
    assert [frame.cpu_seconds for frame in frames] == np.diff(drawn).tolist()
    assert frames[1].cpu_seconds > 0
    assert kernel.rendered.total() == len(frames), "the held-out view of each"


def test_header_holds_what_a_decoder_needs_without_the_rig(moving: Any, tiny_rig: Any, tiny_settings: Any) -> None:
    with open_stream(moving.path) as stream:
        header = stream.header
    assert [camera.name for camera in header.cameras] == list(tiny_rig.names)
    np.testing.assert_allclose(header.cameras[3].world_to_camera, tiny_rig.camera(3).world_to_camera, atol=1e-12)
    assert (header.fps, header.held_out, header.sh_degree) == (25.0, (tiny_rig.held_out,), 1)
    assert (header.source_text, header.licence) == ("rendered for the tests", "CC0-1.0")
    assert header.units == "metre (rendered)"
    assert header.settings["seed"] == 0
    assert header.settings["frame"]["joint_iterations"] == tiny_settings.frame.joint_iterations


# Segments


@pytest.mark.parametrize("stream", ["moving", "still"])
def test_segments_change_how_frames_are_told_and_not_what_is_in_them(
    stream: str, request: pytest.FixtureRequest, encode: Any, tiny_settings: Any
) -> None:
    encoded = request.getfixturevalue(stream)
    rig = request.getfixturevalue(f"{stream}_rig")
    cut = encode(rig, settings=replace(tiny_settings, segment=2), keyframe=encoded.path)
    frames = decoded(cut.path)
    assert [frame.kind == PacketKind.KEY for frame in frames] == [True, False, True, False]
    for frame, state in zip(frames, encoded.states, strict=True):
        assert digest(frame.state) == digest(state)
        for name in (*ATTRIBUTES, "ids"):
            np.testing.assert_array_equal(getattr(frame.state, name), getattr(state, name))
    assert frames[2].refers_to_first
    assert frames[2].packet_bytes < frames[0].packet_bytes / 4, "what has not changed is undetermined again"
    assert [report.kind for report in cut.report.frames][::2] == ["key", "key"]
    assert [report.costs for report in cut.report.frames] == [frame.costs for frame in frames]
    with open_stream(cut.path) as opened:
        assert digest(next(opened.frames(3)).state) == digest(encoded.states[3])


# Determinism


@pytest.mark.parametrize("threads", [1, 5])
def test_bytes_do_not_depend_on_threads(moving: Any, encode: Any, moving_rig: Path, threads: int) -> None:
    assert encode(moving_rig, threads=threads).data == moving.data


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(moving: Any, encode: Any, moving_rig: Path) -> None:
    assert encode(moving_rig).data == moving.data
    other = encode(moving_rig, seed=1, stop=1)
    assert digest(other.states[0]) != digest(moving.states[0]), "more than the seed in the header differs"


CHILD = """
import hashlib, importlib.util, sys
from pathlib import Path

sys.path.append(str(Path(sys.argv[1]).parents[1]))
specification = importlib.util.spec_from_file_location("encoder_conftest", sys.argv[1])
module = importlib.util.module_from_spec(specification)
sys.modules["encoder_conftest"] = module
specification.loader.exec_module(module)
encoded = module._encode(Path(sys.argv[3]), Path(sys.argv[2]))
print(hashlib.sha256(encoded.data).hexdigest())
"""


def test_bytes_do_not_depend_on_the_kernels_instruction_set(
    moving: Any, moving_rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole of training, the transformation cache included."""
    narrower = INSTRUCTION_SETS[: INSTRUCTION_SETS.index(best_instruction_set())]
    if not narrower:
        pytest.skip("this machine runs one instruction set only")
    children = []
    for name in narrower:
        monkeypatch.setenv("DECOGS_INSTRUCTION_SET", name)
        arguments = [str(Path(__file__).with_name("conftest.py")), str(moving_rig), str(tmp_path / f"{name}.dgs")]
        children.append(subprocess.Popen([sys.executable, "-c", CHILD, *arguments], stdout=subprocess.PIPE, text=True))
    for name, child in zip(narrower, children, strict=True):
        out, _ = child.communicate(timeout=120)
        assert out.strip() == hashlib.sha256(moving.data).hexdigest(), name


# Nothing changes


def test_a_still_scene_is_skips_after_the_keyframe(still: Any) -> None:
    frames = decoded(still.path)
    assert kinds(frames) == ["KEY", "SKIP", "SKIP", "SKIP"]
    assert still.selected == {}
    assert all(frame.packet_bytes < 64 for frame in frames[1:])
    assert all(report.selected == 0 for report in still.report.frames[1:])


def test_a_frame_without_changes_costs_its_masks_and_nothing_else(encode: Any, still_rig: Path, still: Any) -> None:
    kernel = NotingKernel()
    again = encode(still_rig, keyframe=still.path, kernel=kernel)
    assert [set(report.seconds) for report in again.report.frames[1:]] == [{"masks", "write", "measure"}] * 3
    assert kernel.done, "or this test shows nothing"
    once = {("refresh", camera) for camera in kernel.viewed}
    assert sorted(kernel.done) == sorted(once), "for the keyframe, and never again"


@pytest.mark.slow
def test_the_shared_still_rig_is_skips_after_the_keyframe(encode: Any, shared_data: Any, tiny_settings: Any) -> None:
    """Real video coding noise against the standard preset's masks; the paper's threshold is higher still."""
    frame = replace(PRESETS["standard"].frame, joint_iterations=1)
    assert frame.masks.threshold <= PRESETS["paper"].frame.masks.threshold
    short = replace(tiny_settings.keyframe, iterations=10, cap=500)
    encoded = encode(
        shared_data("rigs/still"),
        settings=replace(tiny_settings, keyframe=short, frame=frame),
        holdout=["cam00"],
        scale=0.5,
        stop=5,
    )
    assert kinds(decoded(encoded.path)) == ["KEY"] + ["SKIP"] * 4


# Ends that come early


def test_ctrl_c_between_frames_leaves_a_shorter_whole_stream(moving: Any, encode: Any, moving_rig: Path) -> None:
    def interrupt(report: Any) -> None:
        if report.frame == 1:
            raise KeyboardInterrupt

    cut = encode(moving_rig, on_frame=interrupt)
    assert cut.report.interrupted
    assert [report.frame for report in cut.report.frames] == [0, 1]
    check_whole(cut.path, moving, 2)


@pytest.mark.parametrize(("frame", "written"), [(1, 0.0), (1, 0.6), (3, 0.5), (3, 1.0)])
def test_ctrl_c_inside_a_packet_leaves_a_shorter_whole_stream(
    moving: Any, encode: Any, moving_rig: Path, monkeypatch: pytest.MonkeyPatch, frame: int, written: float
) -> None:
    append, done = StreamWriter._append, False

    def torn(writer: Any, data: bytes) -> None:
        nonlocal done
        if len(writer.entries) == frame + 1 and not done:
            done = True
            writer._file.write(data[: int(written * len(data))])
            raise KeyboardInterrupt
        append(writer, data)

    monkeypatch.setattr(StreamWriter, "_append", torn)
    cut = encode(moving_rig, on_frame=None)
    assert cut.report.interrupted
    check_whole(cut.path, moving, frame)


def check_whole(path: Path, full: Any, count: int) -> None:
    frames = decoded(path)
    assert [digest(frame.state) for frame in frames] == [digest(state) for state in full.states[:count]]
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    with open_stream(path) as stream:
        assert (stream.complete, stream.unfinished_bytes) == (True, 0)


@pytest.mark.parametrize("place", ["training", "writing"])
def test_ctrl_c_during_the_keyframe_leaves_nothing(
    encode: Any, moving_rig: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, place: str
) -> None:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    if place == "writing":
        monkeypatch.setattr(StreamWriter, "write", interrupt)
    output = tmp_path / "scene.dgs"
    with pytest.raises(KeyboardInterrupt):
        encode(moving_rig, output=output, on_keyframe_step=interrupt if place == "training" else None)
    assert list(tmp_path.iterdir()) == []


def failing_at(index: int) -> Callable[[Context], Context]:
    """An encode whose training fails in a frame."""

    class Fails(DecogsTrainer):
        def train(self, frame: FrameInput, /) -> TrainedFrame:
            if frame.index == index:
                raise TrainingError(f"frame {index}: no number")
            return super().train(frame)

    return lambda context: replace(context, method=FrameMethod(Fails))


def test_an_error_at_a_later_frame_leaves_what_was_complete_beside_the_name(
    moving: Any, encode: Any, moving_rig: Path, tiny_rig: Any, tmp_path: Path
) -> None:
    rig = tiny_rig.poisoned(moving_rig, tmp_path / "rig", tiny_rig.held_out)
    output = tmp_path / "out" / "scene.dgs"
    output.parent.mkdir()
    with pytest.raises(TrainingError, match=r"no number; the 3 frames before it are in .*scene\.dgs\.part") as raised:
        encode(rig, output=output, context=failing_at(3))
    assert "\n" not in str(raised.value)
    assert not output.exists()
    assert [digest(f.state) for f in decoded(output.with_name("scene.dgs.part"))] == [
        digest(state) for state in moving.states[:3]
    ]


def test_an_older_stream_survives_until_the_new_one_is_whole(
    encode: Any, moving_rig: Path, moving: Any, tmp_path: Path
) -> None:
    output = tmp_path / "scene.dgs"
    output.write_bytes(b"old")
    with pytest.raises(TrainingError):
        encode(moving_rig, output=output, keyframe=moving.path, context=failing_at(1))
    assert output.read_bytes() == b"old"
    output.with_name("scene.dgs.part").unlink()
    assert decoded(encode(moving_rig, output=output, keyframe=moving.path, stop=1).path)


def test_outputs_that_cannot_be_are_refused_before_anything_is_trained(
    encode: Any, moving_rig: Path, tmp_path: Path
) -> None:
    def never(*_: Any) -> None:
        raise AssertionError("training began")

    for output, message in ((tmp_path / "a" / "x.dgs", "no such folder"), (tmp_path, "is a folder")):
        with pytest.raises(UsageError, match=message):
            encode(moving_rig, output=output, on_keyframe_step=never)


# Which frames


def test_a_later_range_begins_its_own_stream(encode: Any, moving_rig: Path) -> None:
    encoded = encode(moving_rig, start=1, stop=4)
    frames = decoded(encoded.path)
    assert [report.frame for report in encoded.report.frames] == [1, 2, 3]
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert kinds(frames) == ["KEY", "SKIP", "DELTA"]


def test_frame_ranges_are_pythons(moving_rig: Path) -> None:
    rig = open_rig(moving_rig)
    for frames, expected in (
        (None, range(0, 4)),
        (slice(1, 3), range(1, 3)),
        (slice(-2, None), range(2, 4)),
        (slice(0, 99), range(0, 4)),
    ):
        assert frame_span(rig, frames) == expected
    for frames in (slice(5, 5), slice(2, 2), slice(9, None), slice(3, 1)):
        with pytest.raises(UsageError, match=r"`frames`: .* has frames 0 to 3; the range holds none of them"):
            frame_span(rig, frames)
    for frames in (slice(None, None, 2), slice(None, None, -1)):
        with pytest.raises(UsageError, match="give consecutive frames"):
            frame_span(rig, frames)


def test_a_frame_that_masks_overlook_is_trained_and_told(
    encode: Any, tiny_rig: Any, moving: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    """The light dims for all cameras alike, under a threshold that no change reaches."""
    rig = tiny_rig.write(tmp_path / "rig", frames=[0, 0], faults=lambda name, frame: Correction(exposure=-6000 * frame))
    deaf = replace(tiny_settings, frame=replace(tiny_settings.frame, masks=MaskSettings(threshold=254.0)))
    dim = encode(rig, settings=deaf, keyframe=moving.path).report.frames[1]
    assert (dim.full_frame_change, dim.selected, dim.kind) == (True, 1.0, "delta")
    assert not any(frame.full_frame_change for frame in moving.report.frames)
