"""Runs over a tiny rig: what they hold, that they share a keyframe, and when one is made again."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.bench import machine
from decogs.bench.measures.metrics import psnr, square_error_map, total_variation
from decogs.bench.measures.regions import find_regions
from decogs.bench.questions.variants import Variant
from decogs.bench.runs import rig_bench as runs
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import KEYFRAME, BenchOptions, read_run
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig

PRESET = Variant("preset", "the preset")
OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=1)

pytestmark = pytest.mark.usefixtures("short_presets")


@pytest.fixture
def bench(three_frames: Path, tmp_path: Path) -> RigBench:
    return RigBench(three_frames, tmp_path, OPTIONS)


def test_a_run_holds_what_the_stream_shows(three_frames: Path, tmp_path: Path) -> None:
    bench = RigBench(three_frames, tmp_path, replace(OPTIONS, keep_streams=True))
    calls: list[str] = []
    run = bench.run(
        PRESET, on_frame=lambda: calls.append("frame"), on_keyframe_step=lambda step, *_: calls.append("step")
    )
    assert calls == ["step"] * 90 + ["frame"] * 3, "the keyframe is nobody's own frame"
    (stream,) = (tmp_path / "streams").glob("three-preset-*.dgs")
    regions = find_regions(open_rig(three_frames), "cam02", range(3), 1.0)
    before: np.ndarray | None = None
    with open_stream(stream) as decoded:
        assert decoded.file_bytes == run.stream_bytes
        assert decoded.header.held_out == ("cam02",)
        for frame, found in zip(decoded.frames(), run.frames, strict=True):
            seen = to_8bit(render_view(decoded.header, frame.splats, "cam02").image)
            errors = square_error_map(
                seen, cv2.imread(str(three_frames / "cam02" / f"{found.frame:04d}.png"))[..., ::-1]
            )
            # Figures are kept to seven digits.
            assert found.psnr == pytest.approx(psnr(errors), rel=1e-6)
            assert found.psnr_dynamic == pytest.approx(psnr(errors, regions.dynamic), rel=1e-6)
            assert found.bytes == frame.packet_bytes
            if before is not None:
                assert found.variation == pytest.approx(total_variation(before, seen, regions.static), rel=1e-6)
            np.testing.assert_array_equal(bench.column_of(run)[:, found.frame], seen[:, run.column])
            before = seen
    assert run.frames[0].variation is None
    assert (run.rig, run.variant, run.camera, run.span, run.seed, run.threads) == (
        "three",
        "preset",
        "cam02",
        [0, 3, 1],
        0,
        1,
    )
    assert run.code == machine.code_version()
    assert "--keyframe keyframe.dgs" in run.command
    assert str(tmp_path) not in bench.file_of(run).read_text(), "reports are handed on"
    assert [frame.frame for frame in run.frames] == [0, 1, 2]
    assert all("measure" not in frame.seconds and frame.cpu_seconds > 0 for frame in run.frames)
    assert run.decode_cpu_seconds is not None
    assert run.decode_cpu_seconds > 0
    assert read_run(bench.file_of(run)) == run
    older = json.loads(bench.file_of(run).read_text())
    del older["decode_cpu_seconds"]
    (tmp_path / "older.json").write_text(json.dumps(older))
    assert read_run(tmp_path / "older.json") == replace(run, decode_cpu_seconds=None)


def test_variants_share_the_keyframe_and_streams_are_removed(bench: RigBench, tmp_path: Path) -> None:
    first, second = bench.run(PRESET), bench.run(Variant("none", "", ablate=("select",)))
    keyframe = bench.find(KEYFRAME)
    assert keyframe is not None
    for run in (first, second):
        assert (run.frames[0].psnr, run.frames[0].bytes) == (keyframe.frames[0].psnr, keyframe.frames[0].bytes)
        assert "keyframe" not in run.frames[0].seconds, "it was taken, not trained"
    assert first.frames[1].psnr != second.frames[1].psnr
    assert [path.name.split("-")[1] for path in (tmp_path / "streams").iterdir()] == ["keyframe"]
    bench.tidy([KEYFRAME])
    assert not (tmp_path / "streams").exists()


def test_a_run_is_found_whatever_it_is_called(bench: RigBench) -> None:
    assert bench.find(PRESET) is None
    run = bench.run(PRESET)
    assert bench.find(PRESET) == run
    assert bench.find(Variant("other", "the same", {"frame.warm_start": 0.9})) == run
    assert bench.find(Variant("other", "not the same", {"frame.warm_start": 0.5})) is None
    assert bench.find(replace(PRESET, method="3dgstream")) is None
    assert bench.find(replace(PRESET, stride=2)) is None
    assert bench.find(replace(PRESET, own_keyframe=True)) is None


@pytest.mark.parametrize(
    "change",
    [
        {"frames": slice(0, 2)},
        {"seeds": (1,)},
        {"scale": 0.5},
        {"holdout": ["cam01"]},
        {"threads": 2},
        {"preset": "paper"},
    ],
)
def test_other_options_are_another_run(bench: RigBench, three_frames: Path, tmp_path: Path, change: Any) -> None:
    bench.run(PRESET)
    assert RigBench(three_frames, tmp_path, OPTIONS).find(PRESET) is not None
    assert RigBench(three_frames, tmp_path, replace(OPTIONS, **change)).find(PRESET) is None


def test_other_code_makes_a_run_again_in_its_place(
    bench: RigBench, three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = bench.run(PRESET)
    monkeypatch.setattr(runs, "code_version", lambda: "0.1.0+other")
    assert bench.find(PRESET) is None
    assert RigBench(three_frames, tmp_path, replace(OPTIONS, any_code=True)).find(PRESET) == run
    again = bench.run(PRESET)
    assert again.code == "0.1.0+other"
    assert bench.file_of(again) == bench.file_of(run)


def test_a_damaged_file_counts_as_no_run(bench: RigBench) -> None:
    path = bench.file_of(bench.run(PRESET))
    whole = json.loads(path.read_text())
    for content in ("", "{", "[]", '{"frames": []}', "null", json.dumps(whole | {"of a later format": 1})):
        path.write_text(content)
        assert bench.find(PRESET) is None
    path.write_text(json.dumps(whole))
    assert bench.find(PRESET) is not None


@pytest.mark.slow
def test_every_second_frame_and_the_last_one(three_frames: Path, tmp_path: Path) -> None:
    bench = RigBench(three_frames, tmp_path, OPTIONS)
    assert [frame.frame for frame in bench.run(replace(PRESET, stride=2)).frames] == [0, 2]
    last = bench.run(Variant("last", "", frames=-1, own_keyframe=True))
    assert [(frame.frame, frame.kind) for frame in last.frames] == [(2, "key")]
    later = RigBench(three_frames, tmp_path, replace(OPTIONS, frames=slice(1, None)))
    assert [frame.frame for frame in later.run(replace(PRESET, stride=5)).frames] == [1]


def test_an_interruption_leaves_no_result(bench: RigBench, tmp_path: Path) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench.run(PRESET, on_frame=stop)
    assert bench.find(PRESET) is None
    assert [path.name.split("-")[1] for path in (tmp_path / "streams").iterdir()] == ["keyframe"], "it can go on"


def test_figures_are_means_over_the_cameras_held_out(three_frames: Path, tmp_path: Path) -> None:
    cameras = ("cam02", "cam04")
    bench = RigBench(three_frames, tmp_path, replace(OPTIONS, holdout=cameras, keep_streams=True))
    run = bench.run(PRESET)
    assert "--holdout cam02 --holdout cam04" in run.command
    (stream,) = (tmp_path / "streams").glob("three-preset-*.dgs")
    with open_stream(stream) as decoded:
        assert decoded.header.held_out == cameras
        *_, last = decoded.frames()
        each = []
        for name in cameras:
            recorded = cv2.imread(str(three_frames / name / "0002.png"))[..., ::-1]
            each.append(psnr(square_error_map(to_8bit(render_view(decoded.header, last.splats, name).image), recorded)))
    assert abs(each[0] - each[1]) > 0.01, "the cameras differ"
    assert run.frames[2].psnr == pytest.approx(np.mean(each), rel=1e-6)


def test_the_rigs_own_camera_is_held_out(three_frames: Path, tmp_path: Path) -> None:
    assert RigBench(three_frames, tmp_path, replace(OPTIONS, holdout=())).camera == "cam00"
    copy = tmp_path / "copy"
    copy.mkdir()
    for camera in three_frames.iterdir():
        if camera.is_dir():
            (copy / camera.name).symlink_to(camera)
    calibration = json.loads((three_frames / "rig.json").read_text())
    (copy / "rig.json").write_text(json.dumps(calibration | {"held_out_camera": "cam03"}))
    assert RigBench(copy, tmp_path, replace(OPTIONS, holdout=())).camera == "cam03"


def test_a_rig_without_cam00_needs_a_name(tiny_rig: Any, tmp_path: Path) -> None:
    rig = tiny_rig.write(tmp_path / "rig", cameras=3, frames=[0, 1])
    calibration = json.loads((rig / "rig.json").read_text())
    calibration["cameras"] = calibration["cameras"][1:]
    (rig / "rig.json").write_text(json.dumps(calibration))
    with pytest.raises(UsageError, match="has no cam00; choose one with `holdout` CAM"):
        RigBench(rig, tmp_path, replace(OPTIONS, holdout=()))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"holdout": ["cam9"]}, "`holdout` cam9: .* has no such camera; it has cam00, cam01"),
        ({"frames": slice(0, 1)}, "give `frames` of at least 2"),
        ({"frames": slice(7, None)}, "`frames`: "),
        ({"scale": 0.0}, "`scale` 0: "),
        ({"seeds": ()}, "`seeds`: give 1 to 100 different numbers"),
        ({"seeds": (0, -1)}, "`seeds`: "),
        ({"seeds": (1, 1)}, "`seeds`: "),
        ({"seeds": range(10**12)}, "`seeds`: "),
        ({"threads": 5000}, "`threads` 5000"),
        ({"preset": "fast"}, "`settings` fast: "),
    ],
)
def test_impossible_options_are_refused(three_frames: Path, tmp_path: Path, change: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        RigBench(three_frames, tmp_path, replace(OPTIONS, **change))
    assert list(tmp_path.iterdir()) == []


def test_the_subject_is_measured_where_a_rig_has_mattes(three_frames: Path, tmp_path: Path) -> None:
    rig = tmp_path / "matted"
    shutil.copytree(three_frames, rig)
    matte = np.zeros((48, 64), np.uint8)
    matte[10:30, 20:40] = 255
    (rig / "truth/mattes/cam02").mkdir(parents=True)
    cv2.imwrite(str(rig / "truth/mattes/cam02/0001.png"), matte)
    bench = RigBench(rig, tmp_path / "report", OPTIONS)
    run = bench.run(PRESET, keep_stream=True)
    with open_stream(bench.stream(PRESET)) as stream:
        seen = to_8bit(render_view(stream.header, list(stream.frames())[1].splats, "cam02").image)
    errors = square_error_map(seen, cv2.imread(str(rig / "cam02/0001.png"))[..., ::-1])
    assert [frame.psnr_subject for frame in run.frames] == [
        None,
        pytest.approx(psnr(errors, matte > 0), rel=1e-6),  # seven digits are kept
        None,
    ]
