"""What an encode writes to: nothing it reads, nothing another one writes or left; said before anything is trained."""

from __future__ import annotations

import errno
import json
import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import decogs.encoder.output.stream_output as stream_output
from decogs.codec.header.header import StreamHeader
from decogs.encoder import EncodeReport
from decogs.encoder.analyze_command import analyze_main
from decogs.encoder.output.observer import EncodeObserver
from decogs.formats.errors import RigError, UsageError
from decogs.formats.files.outputs import GrowingFile
from decogs.formats.stream.container import StreamWriter
from encode_rig import encode_rig as encode_anything
from packets import iterate_packets


class Untrained(EncodeObserver):
    """No test here trains a keyframe: what is wrong is said before."""

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        raise AssertionError("a keyframe is trained")


def encode_rig(*given: Any, **fields: Any) -> EncodeReport:
    return encode_anything(*given, progress=Untrained(), **fields)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("option", ["output", "log", "convergence_log"])
@pytest.mark.parametrize("named", ["rig.json", "cam03/0001.png", "cam99.mp4", "link", "other"])
def test_files_of_the_rig_are_never_written_over(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, option: str, named: str
) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(moving_rig, rig)
    (rig / "cam99.mp4").write_bytes(b"a camera that is not calibrated")
    (rig / "link").symlink_to(rig / "cam03" / "0002.png")
    (rig / "other").hardlink_to(rig / "rig.json")
    before = contents(tmp_path)
    with pytest.raises(UsageError, match=f"(`output`|`log`|`convergence_log`) .*{named}: .*; name another file"):
        encode_rig(rig, **({"output": tmp_path / "x.dgs"} | {option: rig / named}), settings=tiny_settings)
    assert contents(tmp_path) == before


def test_an_analysis_writes_over_no_file_of_the_rig(
    moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(moving_rig, rig)
    before = contents(rig)
    assert analyze_main([str(rig), "--json", str(rig / "rig.json")]) == 2
    assert "--json" in (said := capsys.readouterr().err)
    assert said.count("\n") == 1
    assert contents(rig) == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"log": "x.dgs"}, "`log` .*x.dgs: `output` is written there, too"),
        ({"log": "x.dgs.part"}, "`log` .*x.dgs.part: `output` is written there, too"),
        ({"log": "l", "convergence_log": "l"}, "`convergence_log` .*l: `log` is written there, too"),
        ({"log": "key.dgs"}, "`log` .*key.dgs: is read, as `keyframe`; name another file"),
        ({"output": "key.dgs"}, "`output` .*key.dgs: is read, as `keyframe`; name another file"),
    ],
)
def test_no_two_outputs_in_one_place_and_none_over_the_keyframe(
    moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path, options: dict[str, str], message: str
) -> None:
    shutil.copyfile(moving.path, tmp_path / "key.dgs")
    before = contents(tmp_path)
    paths = {name: tmp_path / value for name, value in ({"output": "x.dgs"} | options).items()}
    with pytest.raises(UsageError, match=message):
        encode_rig(moving_rig, **paths, settings=tiny_settings, keyframe=tmp_path / "key.dgs")
    assert contents(tmp_path) == before


def test_an_analysis_writes_over_no_matte(moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ignored = tmp_path / "m"
    ignored.mkdir()
    for camera in moving_rig.glob("cam*"):
        cv2.imwrite(str(ignored / f"{camera.name}.png"), np.full_like(cv2.imread(str(camera / "0000.png")), 255))
    (tmp_path / "x").hardlink_to(next(ignored.glob("*.png")))
    before = contents(tmp_path)
    assert analyze_main([str(moving_rig), "--ignore", str(ignored), "--json", str(tmp_path / "x")]) == 2
    assert "x: is a matte or a plate of the rig" in capsys.readouterr().err
    assert contents(tmp_path) == before


def test_a_film_is_not_replaced_by_a_stream(moving_rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    for name, said in (("film.mp4", "mp4 is another format"), ("film", "not a .dgs stream, and is not replaced")):
        (tmp_path / name).write_bytes(b"....ftypisom")
        with pytest.raises(UsageError, match=said):
            encode_rig(moving_rig, tmp_path / name, settings=tiny_settings)
        assert (tmp_path / name).read_bytes() == b"....ftypisom"
        (tmp_path / name).unlink()


@pytest.mark.parametrize("resume", [False, True])
def test_a_stream_that_another_encode_writes_is_refused_at_once(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, resume: bool
) -> None:
    with GrowingFile(tmp_path / "x.dgs") as other:
        other.file.write(b"its keyframe")
        other.file.flush()
        with pytest.raises(UsageError, match=r"x\.dgs\.part: another process is writing it"):
            encode_rig(moving_rig, tmp_path / "x.dgs", settings=tiny_settings, resume=resume)
        assert contents(tmp_path) == {"x.dgs.part": b"its keyframe"}


def test_two_encodes_of_one_output_at_once_give_one_whole_stream(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path
) -> None:
    """The second comes while the first is between its frames."""
    output, refusals = tmp_path / "x.dgs", []

    def second(_: Any) -> None:
        with pytest.raises(UsageError, match="another process is writing it") as refused:
            encode(moving_rig, output=output, keyframe=moving.path, seed=1)
        refusals.append(refused)

    assert encode(moving_rig, output=output, keyframe=moving.path, on_frame=second).data == moving.data
    assert len(refusals) == 4


def test_what_an_interrupted_encode_left_is_not_written_over_unasked(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    (tmp_path / "x.dgs.part").write_bytes(moving.data[:-200])
    with pytest.raises(UsageError, match=r"x\.dgs\.part: .* left it; `resume` goes on with it, or delete it"):
        encode_rig(moving_rig, tmp_path / "x.dgs", settings=tiny_settings)
    assert contents(tmp_path) == {"x.dgs.part": moving.data[:-200]}
    assert encode(moving_rig, output=tmp_path / "x.dgs", resume=True).data == moving.data


def test_logs_are_gone_on_with_by_resume_and_begun_anew_without(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "keyframe": moving.path, "frames": slice(2)}
    given |= {"log": tmp_path / "log", "convergence_log": tmp_path / "convergence_log"}
    events = []
    for resume in (False, True, False):
        encode_rig(moving_rig, tmp_path / "x.dgs", resume=resume, **given)
        events.append([json.loads(line)["event"] for line in (tmp_path / "log").read_text().splitlines()])
        assert (tmp_path / "convergence_log").read_text().count("\n") == 10, "what resumed trained nothing"
    assert events == [["start", "frame", "frame", "end"], [*events[0], "start", "end"], events[0]]


def test_a_symbolic_link_is_written_through(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    (tmp_path / "link.dgs").symlink_to(tmp_path / "target.dgs")
    encode(moving_rig, output=tmp_path / "link.dgs", keyframe=moving.path)
    assert (tmp_path / "link.dgs").is_symlink()
    assert (tmp_path / "target.dgs").read_bytes() == moving.data


def test_a_named_pipe_is_written_into(encode: Any, moving: Any, moving_rig: Path, tmp_path: Path) -> None:
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()), daemon=True)
    reader.start()
    report = encode(moving_rig, output=pipe, keyframe=moving.path).report
    reader.join(10)
    assert got == [moving.data]
    assert (report.output, pipe.is_fifo()) == (pipe, True)
    with pytest.raises(UsageError, match="`resume`: a pipe cannot be resumed"):
        encode(moving_rig, output=pipe, resume=True)


def name_too_long(folder: Path) -> Path:
    return folder / ("x" * 251)


def part_is_a_folder(folder: Path) -> Path:
    (folder / "x.dgs.part").mkdir()
    return folder / "x.dgs"


@pytest.mark.parametrize("output", [name_too_long, part_is_a_folder])
def test_what_cannot_grow_is_said_before_the_keyframe_is_trained(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, output: Callable[[Path], Path]
) -> None:
    with pytest.raises(UsageError, match="the file grows there; choose another name"):
        encode_rig(moving_rig, output(tmp_path), settings=tiny_settings)


@pytest.mark.parametrize("frames", [0, 2])
def test_a_full_disk_is_named_with_what_to_do_and_what_is_there_stays(
    encode: Any, moving: Any, moving_rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frames: int
) -> None:
    class Full(StreamWriter):
        def write(self, kind: int, frame: int, payload: bytes, **options: Any) -> int:
            if frame == frames:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return super().write(kind, frame, payload, **options)

    monkeypatch.setattr(stream_output, "StreamWriter", Full)
    with pytest.raises(
        UsageError, match=r"x\.dgs\.part: No space left on device; free space, then continue with `resume`"
    ):
        encode(moving_rig, output=tmp_path / "x.dgs", keyframe=moving.path)
    left = contents(tmp_path).get("x.dgs.part", b"")
    assert moving.data.startswith(left)
    monkeypatch.undo()
    resumed = encode(moving_rig, output=tmp_path / "x.dgs", keyframe=moving.path, resume=True)
    assert (resumed.data, resumed.report.resumed) == (moving.data, frames)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("option", ["log", "convergence_log"])
def test_a_log_that_cannot_be_written_is_named(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path, option: str
) -> None:
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "keyframe": moving.path, option: "/dev/full"}
    with pytest.raises(UsageError, match=f"^`{option}` /dev/full: No space left on device; free space"):
        encode_rig(moving_rig, tmp_path / "x.dgs", **given)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_pipe_or_device_that_is_full_is_named(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any
) -> None:
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "keyframe": moving.path}
    with pytest.raises(OSError, match="No space left on device: '/dev/full'"):
        encode_rig(moving_rig, "/dev/full", **given)
    full = open("/dev/full", "wb", buffering=0)  # noqa: SIM115 (two contexts of different ends)
    with full, pytest.raises(OSError, match="No space left on device: 'standard output'"):
        encode_rig(moving_rig, full, **given)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda rig: rig.update(source="x" * 70_000), "source_text is no text of at most 65536 characters"),
        (lambda rig: rig["cameras"][0].update(fx=1e-5), r"cameras\[0\].fx is no number from 0.001"),
    ],
)
def test_what_a_header_cannot_hold_is_said_before_training(
    moving_rig: Path, tiny_settings: Any, tmp_path: Path, change: Callable[[dict[str, Any]], None], problem: str
) -> None:
    rig = tmp_path / "rig"
    shutil.copytree(moving_rig, rig)
    document = json.loads((rig / "rig.json").read_text())
    change(document)
    (rig / "rig.json").write_text(json.dumps(document))
    with pytest.raises(RigError, match=f"^{rig}: a stream cannot hold this rig .{problem}"):
        encode_rig(rig, tmp_path / "x.dgs", settings=tiny_settings)
    assert not list(tmp_path.glob("x*"))


def test_a_folder_that_takes_no_analysis_is_said_before_it(
    moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a rig whose pictures cannot be read, which an analysis would find first."""
    rig = Path(shutil.copytree(moving_rig, tmp_path / "rig"))
    for picture in rig.glob("cam*/0000.png"):
        picture.write_bytes(picture.read_bytes()[:200])
    assert analyze_main([str(rig), "--json", str(tmp_path / "none" / "x.json")]) == 2
    assert "none: no such folder; create it first" in capsys.readouterr().err


# Footage that is not the stream's


def swapped(rig: Path, copy: Path, names: list[str]) -> Path:
    """The rig with noise in place of these cameras' pictures."""
    shutil.copytree(rig, copy)
    random = np.random.default_rng(5)
    for name in names:
        for path in (copy / name).iterdir():
            blocks = random.integers(0, 256, (6, 8, 3), dtype=np.uint8)
            cv2.imwrite(str(path), np.repeat(np.repeat(blocks, 8, 0), 8, 1))
    return copy


def test_the_keyframe_of_a_stream_that_does_not_tell_its_pictures_is_compared_with_them(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    """What has nothing to do with the scene is told, for a stream from before it told."""
    old = tmp_path / "old.dgs"
    with moving.path.open("rb") as file, old.open("wb") as copy:
        header, *packets = iterate_packets(file)
        known = StreamHeader.from_bytes(header.payload)
        settings = {name: value for name, value in known.settings.items() if name != "recorded"}
        writer = StreamWriter(copy, replace(known, settings=settings).to_bytes())
        writer.write(packets[0].kind, 0, packets[0].payload)
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "frames": slice(1)}
    other = swapped(moving_rig, tmp_path / "rig", ["cam01", "cam03"])
    for rig, expected in ((moving_rig, 0), (other, 1)):
        told: list[str] = []
        encode_rig(rig, tmp_path / "new.dgs", keyframe=old, on_warning=told.append, **given)
        assert len(told) == expected
        assert all("the scene does not match frame 0 of camera cam01 and 1 more cameras" in t for t in told)
