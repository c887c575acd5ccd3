"""What a terminal, a disk, a signal or a stranger's stream does to a command: one line, exit code 2, nothing left."""

from __future__ import annotations

import io
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.decoder import decode
from decogs.decoder.cameras.fields import MAX_FILE_BYTES
from decogs.decoder.cameras.pose_file import read_free_cameras
from decogs.decoder.commands import decode_main, export_main
from decogs.formats.cli.command_line import Parser, in_option_names, run, warn_as
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import StreamWriter
from decogs.formats.system.quiet import quiet_opencv
from packets import iterate_packets

RUN = "import sys; from decogs.decoder import commands; sys.exit(getattr(commands, sys.argv.pop(1))())"


def command(*arguments: object, **options: Any) -> subprocess.CompletedProcess[bytes]:
    """A command in a process of its own, its name without "_main" first."""
    name, *others = (str(argument) for argument in arguments)
    given = [sys.executable, "-c", RUN, f"{name}_main", *others]
    return subprocess.run(given, stdin=options.pop("stdin", subprocess.DEVNULL), capture_output=True, **options)


def without_progress(stderr: bytes) -> str:
    """What a command said, without the lines that a busy machine makes it say on the way."""
    return re.sub(r"^\w+: \d+ of \d+ \w+, \d+:.*\n", "", stderr.decode(), flags=re.MULTILINE)


def one_line(run: subprocess.CompletedProcess[bytes], code: int = 2) -> str:
    said = without_progress(run.stderr)
    assert (run.returncode, said.count("\n")) == (code, 1), said
    return said


def rewritten(stream: Path, **changes: Any) -> Path:
    """The stream with another header, without its index."""
    data = stream.read_bytes()
    packets = list(iterate_packets(io.BytesIO(data)))
    header = StreamHeader.from_bytes(packets[0].payload)
    if "camera" in changes:
        header = replace(header, cameras=(replace(header.cameras[0], name=changes.pop("camera")),), held_out=())
    with stream.open("wb") as file:
        writer = StreamWriter(file, replace(header, **changes).to_bytes())
        for packet in packets[1:-2]:
            writer.write(packet.kind, packet.frame, packet.payload)
        writer.finish()
    return stream


@pytest.mark.parametrize("name", ["\udcff.mp4", "\udcff.exr", "\udcff.usdc"])
def test_names_that_are_no_utf8_are_refused_where_a_library_would_fail_on_them(
    small_stream, tmp_path: Path, name: str
) -> None:
    kind, more = ("export", []) if name.endswith("usdc") else ("decode", ["--view", "cam00", "--frames", ":1"])
    assert r"\udcff" in one_line(command(kind, small_stream.path, *more, "-o", f"{tmp_path}/{name}"))
    assert os.listdir(tmp_path) == ["scene.dgs"]


def test_such_a_name_is_fine_for_a_folder_of_png(small_stream, tmp_path: Path) -> None:
    decode(small_stream.path, f"{tmp_path}/\udcff", view="cam00", frames=slice(1))
    assert os.listdir(f"{tmp_path}/\udcff") == ["cam00_000000.png"]


def test_what_the_terminal_cannot_show_is_escaped(small_stream, tmp_path: Path) -> None:
    stream = rewritten(small_stream.path, camera="日本")
    ended = command("info", stream, env={**os.environ, "PYTHONIOENCODING": "latin-1"})
    assert (ended.returncode, ended.stderr) == (0, b"")
    assert rb"\u65e5\u672c" in ended.stdout


def test_closed_standard_streams_are_one_line(small_stream, tmp_path: Path) -> None:
    for number, arguments in (
        (1, ["info", small_stream.path]),
        (1, ["decode", small_stream.path, "--view", "cam00", "-o", tmp_path / "o"]),
        (0, ["decode", "-", "--view", "cam00", "-o", tmp_path / "o"]),
    ):
        ended = command(*arguments, preexec_fn=lambda number=number: os.close(number))
        assert f"standard {('input', 'output')[number]} is closed" in one_line(ended)
    ended = command("info", "none.dgs", preexec_fn=lambda: os.close(2))
    assert (ended.returncode, ended.stdout) == (2, b""), "errors do not go to stdout, nor into a file that is open"


def test_a_full_disk_behind_standard_output_is_named(small_stream) -> None:
    program = [sys.executable, "-c", RUN, "info_main", str(small_stream.path)]
    with open("/dev/full", "wb") as full:
        ended = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, check=False)
    assert "standard output: No space left on device" in one_line(ended)


def test_openusd_is_not_begun_where_it_would_end_the_process(small_stream, tmp_path: Path) -> None:
    def short_of_memory() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (800 << 20, resource.RLIM_INFINITY))

    output = tmp_path / "o" / "x.usdc"
    output.parent.mkdir()
    ended = command("export", small_stream.path, "-o", output, preexec_fn=short_of_memory)
    assert "0.8 GB of address space (ulimit -v), and OpenUSD needs 2 GB" in one_line(ended)
    assert os.listdir(output.parent) == []


def fails(main: Callable[[list[str]], int], arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    try:
        code = main(arguments)
    except SystemExit as error:
        code = error.code
    printed = capsys.readouterr()
    assert (code, printed.out, printed.err.count("\n")) == (2, "", 1)
    return printed.err


def test_numbers_beyond_all_bounds_are_one_line(small_stream, tmp_path: Path, capsys) -> None:
    asked = [str(small_stream.path), "--view", "cam00", "-o", str(tmp_path / "o")]
    for scale in ("1e308", "1e154", "1e9", "200"):
        assert "above the limit of 67108864 pixels" in fails(decode_main, [*asked, "--scale", scale], capsys)
    huge = "9" * 20
    assert "nothing to decode, no such frame" in fails(
        decode_main, [*asked, "--follow", "--idle", "0.1", "--frames", f"{huge}:"], capsys
    )
    assert decode_main([*asked, "--follow", "--idle", "0.1", "--frames", f"6:{huge}"]) == 0
    assert len(os.listdir(tmp_path / "o")) == 2


def test_two_dashes_are_no_value(small_stream, tmp_path: Path, capsys) -> None:
    asked = [str(small_stream.path), "--view", "cam00", "-o", str(tmp_path / "o")]
    for given in (["--frames", "--"], ["--frames=--"], ["--scale=--"]):
        assert "expected one argument" in fails(decode_main, [*asked, *given], capsys)
    assert "expected one argument" in fails(export_main, [str(small_stream.path), "--output=--"], capsys)


def test_a_pattern_has_one_place_for_the_number(small_stream, tmp_path: Path, capsys) -> None:
    asked = [str(small_stream.path), "--view", "cam00", "-o", str(tmp_path / "a%d%02d.png")]
    assert "has 2 places for the frame's number" in fails(decode_main, asked, capsys)


def test_a_pipe_that_is_cut_says_where(small_stream, tmp_path: Path) -> None:
    packets = list(iterate_packets(io.BytesIO(small_stream.path.read_bytes())))
    data = small_stream.path.read_bytes()
    for frame, where, frames in ((0, "its first keyframe", None), (3, "frame 3", slice(5, None))):
        cut = io.BytesIO(data[: packets[1 + frame].offset + 30])
        with pytest.raises(UsageError, match=f"no such frame came; the stream stops 30 bytes into {where}"):
            decode(cut, tmp_path / "o", view="cam00", frames=frames)


@pytest.mark.parametrize("name", ["a" * 255, "日" * 85, "日" * 255])
def test_long_names_of_cameras_are_cut(small_stream, tmp_path: Path, name: str) -> None:
    decode(rewritten(small_stream.path, camera=name), tmp_path / "o", view=name, frames=slice(2))
    found = sorted(os.listdir(tmp_path / "o"))
    assert [file[-11:] for file in found] == ["_000000.png", "_000001.png"]
    assert all(file.startswith(name[:60]) and len(os.fsencode(file)) <= 211 for file in found)


def test_a_rate_that_no_video_has_is_to_blame_in_one_line(small_stream, tmp_path: Path) -> None:
    ended = command("decode", rewritten(small_stream.path, fps=1e6), "--view", "cam00", "-o", tmp_path / "x.mp4")
    assert "cannot have the stream's 1e+06 frames per second" in one_line(ended)
    for fps in (1e-6, 0.001, 65536.0):
        with pytest.raises(UsageError, match=re.escape(f"cannot have the stream's {fps:g} frames per second")):
            decode(rewritten(small_stream.path, fps=fps), tmp_path / "x.mp4", view="cam00")
    for fps in (0.01, 23.976, 1000.0):
        decode(rewritten(small_stream.path, fps=fps), tmp_path / "x.mp4", view="cam00")
        video = cv2.VideoCapture(str(tmp_path / "x.mp4"))
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(fps, rel=1e-3)
        video.release()


@pytest.mark.parametrize("ended_by", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("kind", ["decode", "export"])
def test_a_signal_leaves_nothing_behind(small_stream, tmp_path: Path, kind: str, ended_by: signal.Signals) -> None:
    """The command waits in the midst of its work; the signal then ends it as signals do, at the latest after that."""
    where = {
        "decode": "decogs.decoder.rendering.played_view.PlayedView.show",
        "export": "decogs.formats.usd.writing.UsdWriter.add_group",
    }
    module, kept, method = where[kind].rsplit(".", 2)
    program = f"""
import signal, sys, time, {module} as patched
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored by what runs under nohup
def wait(*arguments, **options):
    print("waiting", flush=True)
    time.sleep(20)
patched.{kept}.{method} = wait
{RUN}
"""
    given = ["--view", "cam00", "-o", str(tmp_path / "o")] if kind == "decode" else ["-o", str(tmp_path / "o.usda")]
    arguments = [sys.executable, "-c", program, f"{kind}_main", str(small_stream.path), *given]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"waiting\n"
        assert len(os.listdir(tmp_path)) >= 1 + (kind == "decode")
        process.send_signal(ended_by)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, without_progress(said)) == (-ended_by, "")
    assert os.listdir(tmp_path) == ["scene.dgs"]


def test_a_full_disk_under_an_export_is_named(segmented_stream, tmp_path: Path) -> None:
    """A limit on the size of files stands for the disk's."""

    def short() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    for name in ("o.usdc", "o.usda"):
        said = one_line(command("export", segmented_stream.path, "-o", tmp_path / name, preexec_fn=short))
        assert f"{name}: cannot be written (File too large); choose another place" in said
        assert os.listdir(tmp_path) == ["segments.dgs"]


def raises(error: Exception) -> Callable[[], int]:
    def command() -> int:
        raise error

    return command


def test_whatever_word_a_library_has_for_it_memory_is_out_in_one_line(capsys) -> None:
    for error in (
        MemoryError(),
        RuntimeError("can't start new thread"),
        ImportError("libx.so: failed to map segment from shared object"),
        ImportError("libx.so: cannot allocate memory in static TLS block"),
    ):
        assert run(Parser(prog="decogs-x"), raises(error)) == 2
        assert "decogs-x: error: out of memory" in capsys.readouterr().err
    with pytest.raises(RuntimeError, match="a bug"):
        run(Parser(prog="decogs-x"), raises(RuntimeError("a bug")))


def test_a_pose_file_may_be_a_pipe_and_is_read_to_its_bound(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=f"zero: has more than {MAX_FILE_BYTES} bytes"):
        read_free_cameras("/dev/zero")
    pose = {"width": 4, "height": 3, "fx": 4, "world_to_camera": [[float(i == j) for j in range(4)] for i in range(4)]}
    read, write = os.pipe()
    os.write(write, json.dumps(pose).encode())
    os.close(write)
    assert read_free_cameras(f"/dev/fd/{read}").cameras[0].width == 4
    os.close(read)


def test_importing_this_library_leaves_opencvs_log_alone(tmp_path: Path) -> None:
    logging = cv2 if hasattr(cv2, "getLogLevel") else cv2.utils.logging  # OpenCV 4, 5
    program = (
        "import os, cv2; logging = cv2 if hasattr(cv2, 'getLogLevel') else cv2.utils.logging; "
        "before = logging.getLogLevel(); import decogs.formats.rigs, decogs.decoder.output.pictures; "
        "assert logging.getLogLevel() == before > 0; assert 'OPENCV_FFMPEG_LOGLEVEL' not in os.environ"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("OPENCV")}
    subprocess.run([sys.executable, "-c", program], check=True, env=environment)
    before = logging.getLogLevel()
    try:
        logging.setLogLevel(3)
        with quiet_opencv():
            assert logging.getLogLevel() == 0
            with quiet_opencv():
                assert logging.getLogLevel() == 0
            assert logging.getLogLevel() == 0
        assert logging.getLogLevel() == 3
    finally:
        logging.setLogLevel(before)


def test_an_option_that_may_be_repeated_may_be_left_out() -> None:
    parser = Parser(prog="x")
    parser.add_argument("--holdout", action="append", default=[])
    parser.add_argument("--frames")
    assert parser.parse_args([]).holdout == []
    assert parser.parse_args(["--holdout", "a"]).holdout == ["a"]
    for option in ("--holdout", "--frames"):
        with pytest.raises(SystemExit):
            parser.parse_args([option, "--"])


def test_errors_of_the_library_name_the_commands_options(capsys: pytest.CaptureFixture[str]) -> None:
    """Also where an option is called otherwise, in a command within a command, and in an error of more than a text."""
    parser = Parser(prog="decogs-x")
    parser.add_argument("stream")
    parser.add_argument("-o", "--output")
    parser.add_argument("--preset", dest="settings")
    parser.add_subparsers().add_parser("y").add_argument("--max-memory")
    text = "`settings` x, `max_memory`, `output`: no `stream`, `other`"
    for error in (UsageError(text), StreamError("too-large", text, packet=3)):
        assert run(parser, raises(error)) == 2
        assert "decogs-x: error: --preset x, --max-memory, -o: no `stream`, `other`" in capsys.readouterr().err
    warn_as(parser)(text)
    assert capsys.readouterr().err == "decogs-x: warning: --preset x, --max-memory, -o: no `stream`, `other`\n"


def test_an_error_can_be_said_in_the_users_words() -> None:
    with (
        pytest.raises(StreamError, match=r"^--rate 9: too little in packet 3 \[x\]$") as caught,
        in_option_names({"`r` 5": "--rate 9"}),
    ):
        raise StreamError("x", "`r` 5: too little", packet=3)
    assert caught.value.packet == 3


@pytest.mark.parametrize("name", ["k.usda", "k.mp4", "pose.exr"])
def test_no_input_is_written_over(small_stream, tmp_path: Path, capsys, name: str) -> None:
    """Streams and pose files may have any name, that of an output's kind too."""
    (tmp_path / "here").mkdir()
    given = tmp_path / "here" / name
    if name == "pose.exr":
        camera = {"width": 8, "height": 6, "fx": 8, "fy": 8, "cx": 4, "cy": 3, "world_to_camera": np.eye(4).tolist()}
        given.write_text(json.dumps({"name": "free", **camera}))
        arguments = [str(small_stream.path), "--camera", str(given), "-o", str(given), "--frames", ":1"]
    else:
        shutil.copyfile(small_stream.path, given)
        arguments = [str(given), "-o", str(given)] + (["--view", "cam00"] if name == "k.mp4" else [])
    before = given.read_bytes()
    assert (export_main if name == "k.usda" else decode_main)(arguments) == 2
    parameter = "--camera" if name == "pose.exr" else "`stream`"
    assert f"{name}: is read, as {parameter}; name another file" in capsys.readouterr().err
    assert given.read_bytes() == before
    assert list(given.parent.iterdir()) == [given]


@pytest.mark.parametrize("follow", [False, True])
@pytest.mark.parametrize(
    ("named", "output"),
    [
        ("cam00_000002.png", ""),
        ("x_0002.png", "x_####.png"),
        ("x_000002.exr", "x.exr"),
        ("sub/../cam00_000002.png", "."),
    ],
)
def test_no_input_is_written_over_by_the_file_of_a_frame(
    small_stream, tmp_path: Path, named: str, output: str, follow: bool
) -> None:
    folder = tmp_path / "here"
    (folder / "sub").mkdir(parents=True)
    shutil.copyfile(small_stream.path, folder / named)
    options = {"follow": True, "idle": 0.1} if follow else {}
    with pytest.raises(UsageError, match=r"`output` .*2\.(png|exr): is read, as `stream`; name another file"):
        decode(folder / named, f"{folder}/{output}", view="cam00", frames=slice(1, 4), **options)
    assert (folder / named).read_bytes() == small_stream.path.read_bytes()
    there = {path.name for path in folder.iterdir()} - {"sub", Path(named).name}
    assert len(there) <= follow, "those that are shown as they come stay"


@pytest.mark.parametrize("kind", ["decode", "export"])
def test_standard_output_that_is_the_stream_is_refused(small_stream, tmp_path: Path, kind: str) -> None:
    given = ["--view", "cam00"] if kind == "decode" else ["--format", "ply", "--frames", ":1"]
    before = small_stream.path.read_bytes()
    program = [sys.executable, "-c", RUN, f"{kind}_main", str(small_stream.path), *given, "-o", "-"]
    with small_stream.path.open("r+b") as same:
        ended = subprocess.run(program, stdout=same, stderr=subprocess.PIPE, check=False)
    assert "-o -: is read, as `stream`; name another file" in one_line(ended)
    assert small_stream.path.read_bytes() == before


def test_a_stream_from_standard_input_is_not_written_over(small_stream) -> None:
    moved = small_stream.path.rename(small_stream.path.with_suffix(".y4m"))
    before = moved.read_bytes()
    with moved.open("rb") as given:
        said = one_line(command("decode", "-", "--view", "cam00", "-o", moved, stdin=given))
    assert "scene.y4m: is read, as `stream`; name another file" in said
    assert moved.read_bytes() == before


@pytest.mark.parametrize("output", ["x.y4m", "x.rgb", "x_####.ply", "x_####.spz", "x_####.glb"])
def test_a_file_that_the_disk_does_not_take_is_named(small_stream, tmp_path: Path, output: str) -> None:
    """A limit on the size of files stands for the disk's."""
    kind, given = ("decode", ["--view", "cam00"]) if output[1] == "." else ("export", [])

    def short() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    said = one_line(command(kind, small_stream.path, *given, "-o", tmp_path / output, preexec_fn=short))
    assert output.replace("####", "0000") in said
    assert "File too large; make room, or write elsewhere" in said
    assert os.listdir(tmp_path) == ["scene.dgs"]


@pytest.mark.parametrize(
    ("kind", "given"),
    [
        ("decode", ["--view", "cam00"]),
        ("export", ["--format", "spz", "--frames", ":1"]),
        ("export", ["--format", "usdc"]),
    ],
)
def test_standard_output_that_takes_no_bytes_is_named(small_stream, kind: str, given: list[str]) -> None:
    program = [sys.executable, "-c", RUN, f"{kind}_main", str(small_stream.path), *given, "-o", "-"]
    with open("/dev/full", "wb") as full:
        ended = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, check=False)
    assert "standard output: No space left on device; make room, or write elsewhere" in one_line(ended)


@pytest.mark.parametrize("kind", ["export", "info"])
def test_a_pipe_where_a_file_is_needed_is_said(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = ["-o", "x.ply"] if kind == "export" else []
    assert "-: a pipe cannot be seeked; write the stream to a file first" in one_line(command(kind, "-", *given))
