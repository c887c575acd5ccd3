"""Pictures encoded while they are recorded: the bytes of an encode afterwards, whatever is late or lacking."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

from decogs.decoder import open_stream
from decogs.decoder.reading.following import follow_stream
from decogs.encoder.commands import encode_main
from decogs.encoder.settings.effects import PRESET_EFFECTS
from decogs.encoder.settings.presets import PRESETS
from decogs.formats.errors import RigError, StreamError
from decogs.formats.rigs import open_live, open_rig, read_frames
from encode_rig import encode_rig

COMMANDS = Path(sys.executable).parent
PACE = 0.05
"""Seconds from one frame to the next."""


@pytest.fixture
def sources(tmp_path: Path, moving_rig: Path) -> Path:
    """The file of cameras that will record into ``capture``, calibrated as ``moving_rig`` is.

    It waits a minute for whatever comes: longer than any machine holds the cameras up.
    """
    rig = open_rig(moving_rig)
    lines = [f'calibration = "{moving_rig}"', f"fps = {rig.fps}", "late = 60", "end = 60", "[cameras]"]
    lines += [f'{camera.name} = "capture/{camera.name}/{{:04d}}.png"' for camera in rig.cameras]
    path = tmp_path / "sources.toml"
    path.write_text("\n".join(lines))
    return path


def impatient(sources: Path) -> Path:
    """The same for a recording that is over: nothing that is not there will come."""
    sources.write_text(sources.read_text().replace("late = 60", "late = 0.03").replace("end = 60", "end = 0.1"))
    return sources


@contextmanager
def recording(rig: Path, capture: Path) -> Iterator[None]:
    """Cameras record ``rig`` meanwhile; each writes a picture in two halves, one camera after the other."""
    names = sorted(folder.name for folder in rig.iterdir() if folder.is_dir())
    files = {name: sorted((rig / name).glob("*.png")) for name in names}

    def record() -> None:
        for frame in range(len(files[names[0]])):
            for name in names:
                path, data = capture / name / files[name][frame].name, files[name][frame].read_bytes()
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(data[: len(data) // 2])
                time.sleep(0.002)
                with path.open("ab") as file:
                    file.write(data[len(data) // 2 :])
            time.sleep(PACE)

    thread = threading.Thread(target=record)
    thread.start()
    try:
        yield
    finally:
        thread.join()


def test_a_recording_has_the_bytes_of_an_encode_afterwards(
    tmp_path: Path, sources: Path, moving_rig: Path, tiny_settings: Any
) -> None:
    count = open_rig(moving_rig).frame_count
    with recording(moving_rig, tmp_path / "capture"):
        live = encode_rig(open_live(sources), tmp_path / "live.dgs", settings=tiny_settings, frames=slice(count))
    encode_rig(moving_rig, tmp_path / "after.dgs", settings=tiny_settings)
    assert len(live.frames) == count
    assert (tmp_path / "live.dgs").read_bytes() == (tmp_path / "after.dgs").read_bytes()


def test_so_has_a_recording_through_wide_lenses(
    tmp_path: Path, sources: Path, moving_rig: Path, lens_rig: Path, tiny_settings: Any
) -> None:
    sources.write_text(impatient(sources).read_text().replace(str(moving_rig), str(lens_rig)))
    shutil.copytree(lens_rig, tmp_path / "capture")
    live = encode_rig(open_live(sources), tmp_path / "live.dgs", settings=tiny_settings)
    encode_rig(lens_rig, tmp_path / "after.dgs", settings=tiny_settings)
    assert len(live.frames) == open_rig(lens_rig).frame_count
    assert (tmp_path / "live.dgs").read_bytes() == (tmp_path / "after.dgs").read_bytes()


def test_what_a_camera_drops_is_its_picture_before(
    tmp_path: Path, sources: Path, moving_rig: Path, tiny_settings: Any
) -> None:
    """A frame dropped, and a camera that dies: as offline with the picture before copied into the gap.

    The recording is over, and its end is found.
    """
    count = open_rig(moving_rig).frame_count
    capture = shutil.copytree(moving_rig, tmp_path / "capture")
    filled = shutil.copytree(moving_rig, tmp_path / "filled")
    for name, frame in ("cam01", 1), ("cam02", count - 2), ("cam02", count - 1):
        (capture / name / f"{frame:04d}.png").unlink()
        shutil.copyfile(filled / name / f"{frame - 1:04d}.png", filled / name / f"{frame:04d}.png")
    live = encode_rig(open_live(impatient(sources)), tmp_path / "live.dgs", settings=tiny_settings)
    encode_rig(filled, tmp_path / "after.dgs", settings=tiny_settings)
    assert (len(live.frames), live.interrupted) == (count, False)
    assert [set(report.left_out) for report in live.frames[1:2]] == [{"cam01"}]
    assert (tmp_path / "live.dgs").read_bytes() == (tmp_path / "after.dgs").read_bytes()


def test_a_late_picture_is_waited_for(tmp_path: Path, sources: Path, moving_rig: Path) -> None:
    capture, second = tmp_path / "capture", sorted((moving_rig / "cam01").glob("*.png"))[1]
    for name in "cam00", "cam01":
        (capture / name).mkdir(parents=True)
        for path in sorted((moving_rig / name).glob("*.png"))[:2]:
            shutil.copyfile(path, capture / name / path.name)
    (capture / "cam01" / second.name).unlink()

    def deliver() -> None:
        time.sleep(0.2)
        shutil.copyfile(second, capture / "cam01" / second.name)

    thread = threading.Thread(target=deliver)
    frames = read_frames(open_live(sources), names=["cam00", "cam01"])
    next(frames)
    thread.start()
    _, pictures = next(frames)
    thread.join()
    (wanted,) = open_rig(moving_rig).sources[1].read(1, 2)
    assert (pictures[1] == wanted).all()


def test_of_frames_long_recorded_a_gap_is_not_waited_for(tmp_path: Path, sources: Path, moving_rig: Path) -> None:
    """``late`` is a minute here; that others have the frame after it says that the camera dropped this one."""
    sources.write_text(sources.read_text().replace("fps = ", "fps = 0.02 #"))  # a minute is a frame then
    shutil.copytree(moving_rig, tmp_path / "capture")
    (tmp_path / "capture" / "cam01" / "0001.png").unlink()
    began = time.monotonic()
    (_, first), (_, second) = islice(read_frames(open_live(sources)), 2)
    assert (second[1] == first[1]).all()
    assert (second[0] != first[0]).any()
    assert time.monotonic() - began < 30


def test_the_command(
    tmp_path: Path,
    sources: Path,
    moving_rig: Path,
    tiny_settings: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert encode_main(["-o", str(tmp_path / "a.dgs")]) == 2
    assert "give a rig's folder, or --live" in capsys.readouterr().err
    assert encode_main([str(moving_rig), "--live", str(sources), "-o", str(tmp_path / "a.dgs")]) == 2
    assert encode_main(["--live", str(sources), "--effects", "auto", "-o", str(tmp_path / "a.dgs")]) == 2
    assert "--effects auto: a recording that goes on cannot be analysed; name" in capsys.readouterr().err
    for effects, problem in (
        ("motion,sensor_noise", "cannot be analysed, which sensor_noise needs"),
        ("motion,lamp_flicker", "what the lamps are like is not known; give a --keyframe"),
    ):
        assert encode_main(["--live", str(sources), "--effects", effects, "-o", str(tmp_path / "a.dgs")]) == 2
        assert problem in capsys.readouterr().err
    assert not list(tmp_path.glob("a.dgs*"))
    monkeypatch.setitem(PRESETS, "tiny", tiny_settings)
    with recording(moving_rig, tmp_path / "capture"):
        options = ["--preset", "tiny", "--frames", ":3", "--quiet"]
        assert encode_main(["--live", str(sources), "-o", str(tmp_path / "live.dgs"), *options]) == 0
    assert "3 frames" in capsys.readouterr().out
    as_preset = ["--effects", ",".join(PRESET_EFFECTS)]
    assert encode_main([str(moving_rig), "-o", str(tmp_path / "after.dgs"), *options, *as_preset]) == 0
    assert (tmp_path / "live.dgs").read_bytes() == (tmp_path / "after.dgs").read_bytes()


def test_the_pipe(tmp_path: Path, sources: Path, moving_rig: Path, moving: Any) -> None:
    """``decogs-encode --live sources.toml -o - | decogs-view -``: seen while cameras record, whole at the end."""
    capture, count = tmp_path / "capture", open_rig(moving_rig).frame_count
    options = ["--preset", "live", "--quiet", "--keyframe", str(moving.path), "--holdout", "cam02"]
    live = [*options, "--live", str(sources), "--frames", f":{count}", "-o", "-"]
    copied(moving_rig, capture, range(2))
    with (
        subprocess.Popen([COMMANDS / "decogs-encode", *live], stdout=subprocess.PIPE) as encoder,
        subprocess.Popen(
            [COMMANDS / "decogs-view", "-", "--no-browser"],
            stdin=encoder.stdout,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(tmp_path)},  # it is killed, and removes nothing
        ) as viewer,
    ):
        try:
            assert viewer.stdout is not None
            url = viewer.stdout.readline().split()[1]
            early = served(url, lambda data: frames_of(data) == 2)
            assert frames_of(early) == 2
            copied(moving_rig, capture, range(2, count))
            assert encoder.wait(60) == 0
            late = served(url, lambda data: frames_of(data) == count)
        finally:
            encoder.kill()
            viewer.kill()
    as_preset = ["--effects", ",".join(PRESET_EFFECTS)]
    assert encode_main([str(moving_rig), "-o", str(tmp_path / "after.dgs"), *options, *as_preset]) == 0
    assert late == (tmp_path / "after.dgs").read_bytes()
    assert late.startswith(early)


def test_ctrl_c_ends_the_wait_for_the_next_frame(tmp_path: Path, sources: Path, moving_rig: Path, moving: Any) -> None:
    """The stream is whole at once, and so is the command, though ten minutes were to be waited."""
    sources.write_text(sources.read_text().replace("end = 60", "end = 600"))
    copied(moving_rig, tmp_path / "capture", range(2))
    output = tmp_path / "live.dgs"
    log = tmp_path / "log.jsonl"
    options = ["--preset", "live", "--quiet", "--keyframe", str(moving.path), "--holdout", "cam02", "--log", str(log)]
    with subprocess.Popen(
        [COMMANDS / "decogs-encode", "--live", sources, *options, "-o", str(output)],
        stdout=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as encoder:
        try:
            end = time.monotonic() + 60
            # A frame that is written but not yet measured and logged is cut off again.
            while (not log.exists() or log.read_text().count('"event": "frame"') < 2) and time.monotonic() < end:
                time.sleep(0.05)
            encoder.send_signal(signal.SIGINT)
            assert encoder.wait(60) == 130
        finally:
            encoder.kill()
    assert frames_of(output.read_bytes()) == 2


def copied(rig: Path, capture: Path, frames: range) -> None:
    """Every camera's pictures of these frames, each under its name at once."""
    for folder in (folder for folder in rig.iterdir() if folder.is_dir()):
        (capture / folder.name).mkdir(parents=True, exist_ok=True)
        for path in sorted(folder.glob("*.png"))[frames.start : frames.stop]:
            shutil.copyfile(path, tmp := capture / folder.name / "new")
            tmp.rename(capture / folder.name / path.name)


def served(url: str, enough: Callable[[bytes], bool]) -> bytes:
    """What the page is given once that is ``enough``, or after a minute."""
    end = time.monotonic() + 60
    while True:
        with urlopen(url + "stream.dgs") as answer:
            data: bytes = answer.read()
        if enough(data) or time.monotonic() > end:
            return data
        time.sleep(0.05)


def frames_of(data: bytes) -> int:
    """How many frames the beginning of a stream has."""
    with suppress(StreamError), follow_stream(io.BytesIO(data)) as stream:
        return sum(1 for _ in stream.frames())
    return 0


@pytest.mark.parametrize(
    ("replaced", "by", "pattern"),
    [
        ("fps = ", "fps = -", "'fps' is -"),
        ("late = 60", "late = nan", "'late' is NaN"),
        ("[cameras]", "[other]", "'cameras' is no table"),
        ("cam01 = ", "cam77 = ", "'cam77' is no camera of .*, which has cam00, cam01"),
        ("cam01/{:04d}", "cam01/{:999999999d}", "'cam01' is no video, no address, and has not one place"),
        ("cam01/{:04d}", "cam01/0000", "'cam01' is no video, no address, and has not one place"),
        ('calibration = "', 'calibration = "/nowhere', "no calibration|neither a folder"),
    ],
)
def test_a_file_of_sources_that_cannot_be(sources: Path, replaced: str, by: str, pattern: str) -> None:
    text = sources.read_text()
    assert replaced in text
    sources.write_text(text.replace(replaced, by, 1))
    with pytest.raises(RigError, match=pattern) as caught:
        open_live(sources)
    assert "\n" not in str(caught.value)


def test_the_file_on_the_page(tmp_path: Path, moving_rig: Path) -> None:
    """docs/live.md: its example is read, and what it says of values left out is so."""
    page = (Path(__file__).parents[2] / "docs" / "live.md").read_text()
    example = re.search(r"```toml\n(.*?)```", page, re.DOTALL)
    assert example is not None
    (tmp_path / "rig_dir").symlink_to(moving_rig)
    lines = example[1].splitlines()
    shorter = [line for line in lines if "if left out" not in line]
    assert len(shorter) == len(lines) - 4
    rigs = []
    for text in lines, shorter:
        (tmp_path / "sources.toml").write_text("\n".join(text))
        rigs.append(open_live(tmp_path / "sources.toml"))
    assert [camera.name for camera in rigs[0].cameras] == ["cam00", "cam01", "cam02"]
    assert rigs[0].fps == 25
    assert len({source.path for source in rigs[0].sources}) == 3
    assert what_is_known(rigs[0]) == what_is_known(rigs[1])


def what_is_known(rig: Any) -> list[object]:
    """Of a live rig all that its file says."""
    recording = rig.sources[0].recording
    feeds = [opened.keywords for opened in recording.opened.values()]
    told = [{key: value for key, value in feed.items() if key != "clock"} for feed in feeds]
    return [recording.fps, recording.late, recording.end, recording.every, told]


def test_frames_that_a_budget_leaves_no_time_for(
    tmp_path: Path,
    sources: Path,
    moving_rig: Path,
    tiny_settings: Any,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """.1 seconds are two and a half frames: each third one is encoded."""
    shutil.copytree(moving_rig, tmp_path / "capture")
    monkeypatch.setitem(PRESETS, "tiny", tiny_settings)
    given = ["--live", str(impatient(sources)), "--preset", "tiny", "-o", str(tmp_path / "live.dgs"), "--quiet"]
    assert encode_main([*given, "--time-budget", "100ms/frame"]) == 0
    assert "one of 3 frames is encoded, so that the stream has 8.333 a second" in capsys.readouterr().err
    with open_stream(tmp_path / "live.dgs") as stream:
        assert (stream.frame_count, stream.header.fps) == (2, pytest.approx(25 / 3))


def test_pictures_of_another_size(tmp_path: Path, sources: Path, moving_rig: Path) -> None:
    """A later one is dropped, with the reason; the first one is an error."""
    import cv2

    folder = Path(shutil.copytree(moving_rig, tmp_path / "capture")) / "cam01"
    lost: dict[tuple[int, str], str] = {}
    cv2.imwrite(str(folder / "0001.png"), cv2.imread(str(folder / "0001.png"))[:-2])
    frames = read_frames(open_live(sources), 0, 3, on_lost=lambda *found: lost.update({found[:2]: str(found[2])}))
    shown = [pictures[1] for _, pictures in frames]
    assert (shown[1] == shown[0]).all()
    assert (shown[2] != shown[0]).any()
    said = r"\.png: .* pixels, but camera cam01 is calibrated for .*; record in that"
    assert list(lost) == [(1, "cam01")]
    assert re.search("0001" + said, lost[1, "cam01"])
    shutil.copyfile(folder / "0001.png", folder / "0000.png")
    with pytest.raises(RigError, match="0000" + said):
        list(read_frames(open_live(sources)))


def test_nothing_recorded(tmp_path: Path, sources: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert encode_main(["--live", str(impatient(sources)), "-o", str(tmp_path / "a.dgs"), "--preset", "draft"]) == 2
    assert re.search(r"cam\d\d/0000\.png: did not appear in 0\.1 s; start the camera", capsys.readouterr().err)
    assert not list(tmp_path.glob("a.dgs*"))


def test_a_recording_that_went_on_is_resumed(
    tmp_path: Path, sources: Path, moving_rig: Path, tiny_settings: Any
) -> None:
    """The cameras paused for longer than ``end``; what comes after is added to the stream."""
    capture, count = shutil.copytree(moving_rig, tmp_path / "capture"), open_rig(moving_rig).frame_count
    for path in capture.glob(f"*/{count - 1:04d}.png"):
        path.unlink()
    first = encode_rig(open_live(impatient(sources)), tmp_path / "live.dgs", settings=tiny_settings)
    shutil.copytree(moving_rig, capture, dirs_exist_ok=True)
    rest = encode_rig(open_live(sources), tmp_path / "live.dgs", settings=tiny_settings, resume=True)
    encode_rig(moving_rig, tmp_path / "after.dgs", settings=tiny_settings)
    assert (len(first.frames), rest.resumed) == (count - 1, count - 1)
    assert (tmp_path / "live.dgs").read_bytes() == (tmp_path / "after.dgs").read_bytes()
