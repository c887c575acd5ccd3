"""Parts made again, cut off and given up: what stays, and which exit code says so."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.encoder import PRESETS, CorrectionSettings, EncodeSettings, join
from decogs.encoder.commands import encode_main
from decogs.encoder.parts.commands import join_main
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import PacketKind
from packets import iterate_packets
from part_takes import Make


def test_a_part_that_is_there_is_left_alone(
    make: Make, key: Path, parts: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = Path(shutil.copy(parts[1], tmp_path / "part.dgs"))
    before = copy.stat()
    make(copy, (2, 4), keyframe=key)
    after = copy.stat()
    assert (after.st_mtime_ns, after.st_ino) == (before.st_mtime_ns, before.st_ino)


@pytest.mark.parametrize("change", ["time", "size"])
def test_a_part_is_made_anew_where_its_own_recordings_changed(
    make: Make, rig: Path, key: Path, parts: list[Path], tmp_path: Path, change: str
) -> None:
    copied = Path(shutil.copytree(rig, tmp_path / "rig"))
    pictures = sorted(copied.glob("cam*/0003.png"))
    part = make(tmp_path / "part.dgs", (2, 4), keyframe=key, rig=copied)
    assert part.read_bytes() == parts[1].read_bytes(), "where the rig lies does not matter"
    before = part.stat()
    later = before.st_mtime_ns + 10**9
    for picture in copied.glob("cam*/0005.png"):
        os.utime(picture, ns=(later, later))
    make(part, (2, 4), keyframe=key, rig=copied)
    assert part.stat().st_ino == before.st_ino, "another part's recordings do not matter"
    if change == "time":
        os.utime(pictures[0], ns=(later, later))
    else:
        was = pictures[0].stat()
        pictures[0].write_bytes(pictures[0].read_bytes() + b"\0")  # behind the picture's end
        os.utime(pictures[0], ns=(was.st_atime_ns, was.st_mtime_ns))
    make(part, (2, 4), keyframe=key, rig=copied)
    assert part.stat().st_ino != before.st_ino
    assert (part.read_bytes() == parts[1].read_bytes()) == (change == "time"), "the manifest has sizes, not times"


@pytest.mark.parametrize("leftover", [0, 5, 400, -9])
@pytest.mark.parametrize("there", [False, True])
def test_what_a_killed_one_has_left_is_made_anew(
    make: Make, key: Path, parts: list[Path], tmp_path: Path, leftover: int, there: bool
) -> None:
    (tmp_path / "part.dgs.part").write_bytes(parts[0].read_bytes()[:leftover])
    if there:
        (tmp_path / "part.dgs").write_bytes(parts[1].read_bytes()[:-1])
    assert make(tmp_path / "part.dgs", (2, 4), keyframe=key).read_bytes() == parts[1].read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["part.dgs"]


@pytest.mark.parametrize("left", ["an encode", "its keyframe, cut off", "not a stream", "its damaged stream"])
def test_what_somebody_may_go_on_with_is_not_written_over(
    make: Make, whole: Path, key: Path, parts: list[Path], tmp_path: Path, left: str
) -> None:
    """By a part, a join, or any file that is written at once: the stream stays that an encode would resume."""
    with whole.open("rb") as file:
        first = next(packet for packet in iterate_packets(file) if packet.kind == PacketKind.KEY)
    data = bytearray(whole.read_bytes()[: first.offset + 30 if left == "its keyframe, cut off" else -200])
    if left == "its damaged stream":
        data[len(data) // 2] ^= 1
    growing = tmp_path / "scene.dgs.part"
    growing.write_bytes(b"notes" if left == "not a stream" else data)
    before = growing.read_bytes()
    message = r"scene.dgs.part: a command that was cut off left it; delete it, unless"
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "scene.dgs", (2, 4), keyframe=key)
    with pytest.raises(UsageError, match=message):
        join(parts, tmp_path / "scene.dgs")
    assert growing.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs.part"]


def test_a_join_that_was_cut_off_is_made_anew_where_that_is_asked_for(
    whole: Path, parts: list[Path], make: Make, tmp_path: Path
) -> None:
    output, growing = tmp_path / "scene.dgs", tmp_path / "scene.dgs.part"
    growing.write_bytes(whole.read_bytes()[:-200])
    join(parts, output, resume=True)
    assert output.read_bytes() == whole.read_bytes()
    growing.write_bytes(make(tmp_path / "seed.dgs", seed=1).read_bytes()[:-200])
    with pytest.raises(UsageError, match=r"scene.dgs.part: a command that was cut off left it"):
        join(parts, output, resume=True)
    assert growing.exists()


def test_an_interrupted_part_leaves_nothing(make: Make, key: Path, tmp_path: Path) -> None:
    from decogs.encoder import EncodeObserver

    class Interrupt(EncodeObserver):
        def frame(self, report: Any) -> None:
            if report.frame == 2:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "part.dgs", (2, 4), keyframe=key, progress=Interrupt())
    assert not list(tmp_path.iterdir())


# Exit codes


@pytest.mark.parametrize("ended_by", [signal.SIGTERM, signal.SIGHUP])
def test_a_farm_that_takes_the_machine_back_may_try_again(rig: Path, tmp_path: Path, ended_by: signal.Signals) -> None:
    """The part waits in the middle, its first packets written; the signal then ends it with 75, and nothing is left."""
    code = """
import signal, sys, time
import decogs.encoder.stream.encoder as stream
from decogs.encoder.commands import encode_main
from decogs.encoder.parts.commands import join_main
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored by what runs under nohup
def wait(*_):
    print("in the middle", flush=True)
    time.sleep(60)
stream.StreamEncoder._encode_next = wait
sys.exit(encode_main(sys.argv[1:]))
"""
    output = tmp_path / "part.dgs"
    options = [
        "--preset",
        "draft",
        "--effects",
        "none",
        "--segment",
        "2",
        "--closed",
        "--only",
        "0:2",
        "-o",
        str(output),
    ]
    with subprocess.Popen(
        [sys.executable, "-c", code, str(rig), *options, "--scale", "0.25"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "in the middle\n"
        assert (tmp_path / "part.dgs.part").stat().st_size
        process.send_signal(ended_by)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 75
    assert said.splitlines()[-1] == f"decogs-encode: ended by {ended_by.name}; nothing was written, try again"
    assert not list(tmp_path.iterdir())


@pytest.fixture
def command(rig: Path, settings: EncodeSettings, key: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setitem(PRESETS, "tiny", replace(settings, effects=(), corrections=CorrectionSettings()))
    options = ["--preset", "tiny", "--effects", "motion", "--segment", "2", "--closed", "--threads", "1"]

    def run(*more: str) -> int:
        return encode_main([str(rig), *options, "-o", str(tmp_path / "part.dgs"), *more])

    assert run("--only", "0:1") == 0
    (tmp_path / "part.dgs").rename(tmp_path / "key.dgs")
    return run


def test_codes_tell_whether_to_try_again(
    command: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    part = ["--only", "2:4", "--keyframe", str(tmp_path / "key.dgs")]
    with (tmp_path / "part.dgs.part").open("wb") as other:
        fcntl.flock(other.fileno(), fcntl.LOCK_EX)
        assert command(*part) == 75
        assert "another process is writing it" in capsys.readouterr().err

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as broken:
        broken.setattr("decogs.formats.stream.container.StreamWriter._append", full)
        assert command(*part) == 75
        assert "No space left on device" in capsys.readouterr().err
    assert command(*part, "--seed", "1") == 2
    assert command("--only", "3:4", "--keyframe", str(tmp_path / "key.dgs")) == 2
    assert command("--only", "2:4", "--keyframe", str(tmp_path / "none.dgs")) == 2
    assert capsys.readouterr().err.count("\n") == 3
    for said in ("part with frames 2 to 3", "all 2 frames were already encoded"):
        assert command(*part) == 0
        assert said in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["key.dgs", "part.dgs"]


def test_the_join_command(parts: list[Path], whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "scene.dgs"
    assert join_main([*map(str, parts), "-o", str(output)]) == 0
    assert output.read_bytes() == whole.read_bytes()
    assert f"3 parts, 7 frames, {whole.stat().st_size} bytes" in capsys.readouterr().out
    assert join_main([*map(str, parts[1:]), "-o", str(tmp_path / "less.dgs")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]


class TwoFaced:
    """`open_regular` for a part that is another file at its second read."""

    def __init__(self, path: Path, then: bytes) -> None:
        self._path, self._then, self._read = path, then, False

    def __call__(self, path: Path) -> Any:
        if path == self._path and self._read:
            path.write_bytes(self._then)
        self._read |= path == self._path
        return path.open("rb")


@pytest.mark.parametrize(
    "then", ["empty", "cut", "another part", "another keyframe's part", "the keyframe", "a stream"]
)
def test_a_part_that_changes_between_its_two_reads_is_refused(
    make: Make,
    whole: Path,
    key: Path,
    parts: list[Path],
    tmp_path: Path,
    then: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    mine = Path(shutil.copy(parts[1], tmp_path))
    replaced = {
        "empty": lambda: b"",
        "cut": lambda: mine.read_bytes()[:-300],
        "another part": parts[2].read_bytes,
        "another keyframe's part": lambda: make(tmp_path / "own.dgs", (0, 2), seed=1).read_bytes(),
        "the keyframe": key.read_bytes,
        "a stream": whole.read_bytes,
    }[then]()
    monkeypatch.setattr("decogs.encoder.parts.joining.open_regular", TwoFaced(mine, replaced))
    with pytest.raises(UsageError, match=r"2-4.dgs: the part (was changed while it was joined|is damaged)"):
        join([parts[0], mine, parts[2]], tmp_path / "joined.dgs")
    assert not list(tmp_path.glob("joined*"))


def test_a_part_through_a_pipe_is_refused_without_waiting(
    parts: list[Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """All of them, one of them, standard input, and a named pipe that nobody writes into."""
    os.mkfifo(tmp_path / "fifo")
    line = "import sys; from decogs.encoder.parts.commands import join_main; sys.exit(join_main())"
    for given in (
        f"<(cat {parts[0]}) {parts[1]} {parts[2]}",
        " ".join(f"<(cat {path})" for path in parts),
        f"{parts[0]} {parts[1]} /dev/stdin",
        f"{parts[0]} {tmp_path}/fifo {parts[2]}",
        f"{parts[0]} {tmp_path} {parts[2]}",
    ):
        joined = f"cat {parts[2]} | {sys.executable} -c '{line}' {given} -o {tmp_path}/joined.dgs"
        assert subprocess.run(["bash", "-c", joined], timeout=60).returncode == 2
        said = capfd.readouterr().err
        assert re.search("(this is no regular file|Is a directory); give the file of a part", said)
        assert said.count("\n") == 1
        assert not list(tmp_path.glob("joined*"))
