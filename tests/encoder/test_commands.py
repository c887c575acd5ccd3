"""``decogs-encode``: what it prints, returns and leaves behind, also when the rig or the user stops it."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS
from decogs.encoder.commands import encode_main
from decogs.encoder.settings.effects import PRESET_EFFECTS

AS_PRESET = ["--effects", ",".join(PRESET_EFFECTS)]
"""What the preset does by itself, whatever the scene calls for."""


@pytest.fixture(autouse=True)
def tiny_preset(monkeypatch: pytest.MonkeyPatch, tiny_settings: Any) -> None:
    monkeypatch.setitem(PRESETS, "tiny", tiny_settings)


@pytest.fixture
def refused(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs the command, which must fail with code 2 and leave no output, and returns its one line."""

    def run(rig: Path, *options: str, output: Path | str | None = None) -> str:
        folder = tmp_path / "out"
        folder.mkdir(exist_ok=True)
        name = folder / "scene.dgs" if output is None else output
        try:
            code = encode_main([str(rig), "-o", str(name), "--preset", "tiny", *options])
        except SystemExit as error:
            code = error.code  # type: ignore[assignment]
        printed = capfd.readouterr()
        assert code == 2
        assert printed.out == ""
        assert printed.err.count("\n") == 1
        assert printed.err.startswith("decogs-encode: error: ")
        assert not Path(name).is_file()
        return printed.err

    return run


def test_a_rig_becomes_a_stream_and_a_summary(
    moving: Any, moving_rig: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "scene.dgs"
    arguments = [str(moving_rig), "-o", str(output), "--preset", "tiny", "--holdout", "cam02", "--threads", "2"]
    arguments += AS_PRESET
    assert encode_main([*arguments, "--seed", "0", "--device", "auto", "-q", "--log", str(tmp_path / "log.jsonl")]) == 0
    assert output.read_bytes() == moving.data
    printed = capfd.readouterr()
    assert printed.err == "", "no progress by -q"
    lines = printed.out.splitlines()
    assert lines[0] == f"{output}: 4 frames, {len(moving.data)} bytes"
    held_out = [frame.held_out_psnr for frame in moving.report.frames]
    assert lines[1] == (
        f"held-out PSNR  first {held_out[0]:.2f}  mean {np.mean(held_out):.2f}  last {held_out[-1]:.2f} dB"
    )
    later = moving.report.frames[1:]
    assert re.fullmatch(
        rf"after the first frame  {np.mean([f.bytes for f in later]):.0f} bytes, \d+\.\d\d s, \d+\.\d\d CPU-s, "
        rf"{np.mean([f.selected for f in later]):.1%} selected \(means\)",
        lines[2],
    )
    assert len((tmp_path / "log.jsonl").read_text().splitlines()) == 6
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.jsonl", "scene.dgs"]


def test_a_stream_goes_to_stdout_and_all_else_to_stderr(
    moving: Any, moving_rig: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    given = ["--preset", "tiny", "--holdout", "cam02", "--keyframe", str(moving.path), *AS_PRESET]
    assert encode_main([str(moving_rig), "-o", "-", *given]) == 0
    printed = capfdbinary.readouterr()
    assert printed.out == moving.data
    assert printed.err.decode().startswith(f"-: 4 frames, {len(moving.data)} bytes\n")


def test_a_terminal_gets_no_stream(moving_rig: Path, refused: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert "-o -: the stream would go to the terminal; redirect it" in refused(moving_rig, output=Path("-"))


def test_resuming_says_what_was_there(
    moving: Any, moving_rig: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "scene.dgs"
    arguments = [str(moving_rig), "-o", str(output), "--preset", "tiny", "--holdout", "cam02", "--resume", *AS_PRESET]
    said = []
    for left in (b"", moving.data[:-100], None):
        if left is not None:
            output.unlink(missing_ok=True)
            (tmp_path / "scene.dgs.part").write_bytes(left)
        assert encode_main(arguments) == 0
        assert output.read_bytes() == moving.data
        said.append(capfd.readouterr().out.splitlines()[0])
    assert said == [
        f"{output}: 4 frames, {len(moving.data)} bytes; none of them were already encoded",
        f"{output}: 4 frames, {len(moving.data)} bytes; 4 of them were already encoded",
        f"{output}: all 4 frames were already encoded, {len(moving.data)} bytes",
    ]


def test_options_reach_the_encoder(moving_rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.dgs"
    arguments = ["--preset", "tiny", "--frames", "-3:3", "--scale", "0.5", "--holdout", "cam00", "--holdout", "cam04"]
    arguments += ["--segment", "1"]
    assert encode_main([str(moving_rig), "-o", str(output), *arguments, "--seed", "7"]) == 0
    with open_stream(output) as stream:
        assert stream.frame_count == 2
        assert stream.header.held_out == ("cam00", "cam04")
        assert [frame.refers_to_first for frame in stream.frames()] == [False, True]
        assert stream.header.first_frame == 1, "the range -3:3 of four frames begins at the rig's frame 1"
        assert (stream.header.cameras[0].width, stream.header.cameras[0].height) == (64, 48)
        assert (stream.header.settings["seed"], stream.header.settings["scale"]) == (7, 0.5)


@pytest.mark.usefixtures("brief_baseline")
def test_switches_reach_the_encoder(moving: Any, dense: Any, moving_rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.dgs"
    given = [str(moving_rig), "-o", str(output), "--preset", "tiny", "--holdout", "cam02"]
    assert encode_main([*given, "--method", "3dgstream", "--keyframe", str(moving.path)]) == 0
    assert output.read_bytes() == dense.data
    assert encode_main([*given, "--ablate", "select,gate", "--frames", ":1"]) == 0
    with open_stream(output) as stream:
        assert stream.header.settings["frame"]["ablated"] == ["gate"]
        assert stream.header.settings["frame"]["selection"]["rule"] == "all"
    assert encode_main([*given, "--selection", "paper", "--method", "decogs", "--frames", ":1"]) == 0
    with open_stream(output) as stream:
        assert stream.header.settings["frame"]["selection"]["rule"] == "paper"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scale", "0"], "--scale 0: give a number above 0"),
        (["--scale", "nan"], "--scale nan"),
        (["--scale", "half"], "--scale: 'half' is no number"),
        (["--holdout", "cam9"], "--holdout cam9: "),
        ([o for i in range(5) for o in ("--holdout", f"cam0{i}")], "every camera is held out; leave at least one"),
        (["--preset", "nope"], "--preset nope: there is no such preset; choose from live, draft, standard"),
        (["--method", "nope"], "--method nope: there is no such method; choose from decogs, paper, 3dgstream"),
        (["--ablate", "select,x"], "--ablate x: there is no such part; choose from select, focus, gate"),
        (["--selection", "x"], "--selection x: there is no such selection rule; choose from paper, weight"),
        (["--method", "3dgstream", "--selection", "paper"], "--method 3dgstream trains every Gaussian; drop one"),
        (["--keyframe", "/no/such.dgs"], "--keyframe /no/such.dgs: No such file or directory"),
        (["--frames", "5:5"], "--frames: "),
        (["--frames", "-9:-8"], "--frames: "),
        (["--frames", "two"], "frames 'two' are no range; write A:B"),
        (["--device", "cuda"], "--device cuda: "),
        (["--device", "abacus"], "--device abacus: choose from"),
        (["--seed", "-1"], "--seed -1: "),
        (["--threads", "-2"], "no number of threads"),
        (["--max-memory", "lots"], "'lots' is no size; write bytes, or"),
        (["--max-memory", "9M"], "--max-memory: 5 cameras of up to 64x48 and 1200 Gaussians may need "),
        (["--log", "/no/such/folder/log"], "--log /no/such/folder/log: No such file or directory"),
        (["--quality", "-9"], "--quality -9: give a number from 0"),
        (["--quality", "9", "--lossless"], "--lossless: --quality codes less than every change"),
        (["--bitrate", "9", "--max-mb-per-frame", "9"], "are one budget in two units"),
        (["--segment", "99999999999999999999"], "--segment: '99999999999999999999' is no whole number of at most 18"),
        (
            ["--segment", "2147483648"],
            "--segment 2147483648: give a number of frames, at least 1 and at most 2147483647",
        ),
        (["--threads", "١"], "--threads: '١' is no number of threads"),
        (["--time-budget", "1e308"], "--time-budget 1e308: give from 0.0001 to 1e+06 seconds a frame"),
        (["--time-budget", "1e-308"], "--time-budget 1e-308: give from 0.0001 to 1e+06 seconds a frame"),
        (["--crf", "9"], "unrecognized arguments: --crf 9"),
    ],
)
def test_options_that_cannot_be(
    moving_rig: Path, refused: Any, options: list[str], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert message in refused(moving_rig, *options)


def test_places_that_cannot_be(moving_rig: Path, refused: Any, tmp_path: Path) -> None:
    assert "missing: no such folder; create it first" in refused(moving_rig, output=tmp_path / "missing" / "x.dgs")
    for folder in (tmp_path, ".", "./", "/", ""):
        assert "is a folder; name a file in it" in refused(moving_rig, output=folder)
    assert "there is no such folder" in refused(tmp_path / "no_rig")
    assert "no calibration" in refused(tmp_path)


def broken_picture(rig: Path) -> str:
    path = rig / "cam03" / "0000.png"
    path.write_bytes(path.read_bytes()[:500])
    return "cam03/0000.png: "


def missing_camera(rig: Path) -> str:
    shutil.rmtree(rig / "cam03")
    return "cam03 is missing; put it back or remove the camera from rig.json"


def missing_picture(rig: Path) -> str:
    (rig / "cam03" / "0003.png").unlink()
    return "cam03"


def other_size(rig: Path) -> str:
    cv2.imwrite(str(rig / "cam03" / "0000.png"), np.zeros((10, 10, 3), np.uint8))
    return "cam03: 10 x 10 pixels"


def nan_in_an_exr(rig: Path) -> str:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for path in list((rig / "cam03").iterdir()):
        pixels = (cv2.imread(str(path))[..., ::-1] / 255.0).astype(np.float32)
        if path.stem == "0000":
            pixels[7, 9, 1] = np.nan
        OpenEXR.File(header, {"RGB": pixels}).write(str(path.with_suffix(".exr")))
        path.unlink()
    return "cam03/0000.exr: 1 pixel(s) are NaN or infinite"


def no_poses(rig: Path) -> str:
    document = json.loads((rig / "rig.json").read_text())
    document["cameras"][3]["world_to_camera"][0] = [0, 0, 0, 0]
    (rig / "rig.json").write_text(json.dumps(document))
    return "cam03"


def video_that_breaks(rig: Path) -> str:
    """A video in place of the pictures whose index lists all frames, but whose data stop after the first ones."""
    folder = rig / "cam03"
    pictures = [cv2.imread(str(path)) for path in sorted(folder.iterdir())]
    shutil.rmtree(folder)
    video = rig / "cam03.mp4"
    writer = cv2.VideoWriter(str(video), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), 25, (64, 48))
    for picture in pictures:
        writer.write(picture)
    writer.release()
    data = bytearray(video.read_bytes())
    start = data.index(b"mdat") + 4
    size = int.from_bytes(data[start - 8 : start - 4], "big") - 8
    data[start + size // 2 : start + size] = bytes(size - size // 2)
    video.write_bytes(data)
    text = (rig / "rig.json").read_text().replace('"file": "cam03"', '"file": "cam03.mp4"')
    (rig / "rig.json").write_text(text)
    return "cam03.mp4"


@pytest.mark.parametrize(
    "breaks",
    [broken_picture, missing_camera, missing_picture, other_size, nan_in_an_exr, no_poses, video_that_breaks],
)
def test_rigs_that_break(moving_rig: Path, refused: Any, tmp_path: Path, breaks: Callable[[Path], str]) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(moving_rig, rig)
    named = breaks(rig)
    assert named in refused(rig)


def test_a_later_picture_that_is_broken_is_a_warning(
    moving_rig: Path,
    tiny_settings: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(PRESETS, "tiny", tiny_settings)
    rig = Path(shutil.copytree(moving_rig, tmp_path / "rig"))
    (rig / "cam03" / "0002.png").write_bytes(b"")
    arguments = [str(rig), "-o", str(tmp_path / "scene.dgs"), "--preset", "tiny", "--frames", ":3", "-q"]
    assert encode_main(arguments) == 0
    warnings = capfd.readouterr().err
    assert warnings.count("camera cam03") == 1
    assert f"warning: camera cam03 has no picture in frame 2; {rig}/cam03/0002.png: this is not a PNG file" in warnings


CHILD = """
import json, sys
from dataclasses import replace
from decogs.encoder import PRESETS
from decogs.encoder.commands import encode_main
from decogs.encoder.settings.presets import EncodeSettings

keyframe, frame = json.loads(sys.argv.pop(1))
start = PRESETS["draft"]
PRESETS["child"] = replace(
    start,
    keyframe=replace(start.keyframe, iterations=keyframe, cap=500, validation_fraction=0.0),
    frame=replace(start.frame, joint_iterations=frame),
)
sys.exit(encode_main())
"""
ENDLESS = 1_000_000


def interrupted(rig: Path, output: Path, keyframe: int, frame: int, event: str) -> subprocess.CompletedProcess[str]:
    """Runs the command and sends it SIGINT shortly after its log tells of ``event``."""
    log = output.with_suffix(".jsonl")
    arguments = [str(rig), "-o", str(output), "--preset", "child", "--log", str(log), "--threads", "1", "-q"]
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, json.dumps([keyframe, frame]), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell's background jobs ignore Ctrl-C and pass that on; the child is to behave as in the foreground.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        deadline = time.monotonic() + 60
        while not (log.exists() and f'"event": "{event}"' in log.read_text()):
            assert child.poll() is None, child.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.3)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
    finally:
        child.kill()
        child.communicate()
    return subprocess.CompletedProcess(arguments, child.returncode, out, err)


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_leaves_a_shorter_stream_and_says_so(moving_rig: Path, tmp_path: Path) -> None:
    output = tmp_path / "scene.dgs"
    ended = interrupted(moving_rig, output, 20, ENDLESS, "frame")
    assert ended.returncode == 130
    assert f"{output}: 1 frame, " in ended.stdout
    assert "interrupted by Ctrl-C after frame 0: the stream is complete up to it" in ended.stdout
    assert ended.stderr == ""
    with open_stream(output) as stream:
        assert stream.complete
        assert [frame.index for frame in stream.frames()] == [0]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scene.dgs", "scene.jsonl"]
    assert json.loads((tmp_path / "scene.jsonl").read_text().splitlines()[-1])["interrupted"] is True


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_during_the_keyframe_leaves_nothing(moving_rig: Path, tmp_path: Path) -> None:
    ended = interrupted(moving_rig, tmp_path / "scene.dgs", ENDLESS, 1, "start")
    assert ended.returncode == 130
    assert ended.stdout == ""
    assert ended.stderr == "decogs-encode: interrupted\n"
    assert [path.name for path in tmp_path.iterdir()] == ["scene.jsonl"]
