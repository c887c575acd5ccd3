"""``--only`` and ``decogs-join``: a take in parts has the bytes of the same encode in one go."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction
from decogs.decoder.exporting.exporting import export
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS, CorrectionSettings, EffectChoice, EncodeSettings, Switches, Targets, join
from decogs.encoder.commands import encode_main, join_main
from decogs.encoder.parts.manifest import Part, made_with, part_frames, read_part
from decogs.encoder.settings.effects import PRESET_EFFECTS
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.encoder.settings.reading import read_settings
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import FRAME_KINDS, MAX_FRAME, PacketKind, StreamWriter
from encode_rig import encode_rig as encode
from packets import iterate_packets

MOMENTS = (0, 1, 3, 1, 3, 0, 3)
SEGMENT = 2
FRAMES = len(MOMENTS)


def drifting(name: str, frame: int) -> Correction:
    return Correction(exposure=100 * frame) if name == "cam01" else Correction()


@pytest.fixture(scope="module")
def rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "take", frames=MOMENTS, faults=drifting)


@pytest.fixture(scope="module")
def settings(tiny_settings: EncodeSettings) -> EncodeSettings:
    """With all that goes from frame to frame, and a camera that is compensated."""
    masks = replace(tiny_settings.frame.masks, since_trained=True)
    significance = SignificanceSettings(threshold=1.0)
    frame = replace(tiny_settings.frame, masks=masks, joint_iterations=20, significance=significance)
    corrections = CorrectionSettings(exposure=("cam01",))
    return replace(tiny_settings, frame=frame, detect_per_frame=True, corrections=corrections)


Make = Callable[..., Path]


@pytest.fixture(scope="module")
def make(rig: Path, settings: EncodeSettings) -> Make:
    """``make(output, only)``: a part of the take, or all of it."""

    def run(output: Path, only: tuple[int, int] | None = None, **options: Any) -> Path:
        given: dict[str, Any] = {"settings": settings, "segment": SEGMENT, "closed": True, "threads": 1} | options
        encode(given.pop("rig", rig), output, only=None if only is None else range(*only), **given)
        return output

    return run


@pytest.fixture(scope="module")
def whole(make: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("whole") / "scene.dgs")


@pytest.fixture(scope="module")
def key(make: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("key") / "key.dgs", (0, 1))


@pytest.fixture(scope="module")
def parts(make: Make, key: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("parts")
    spans = [(0, 2), (2, 4), (4, 7)]
    return [make(folder / f"{a}-{b}.dgs", (a, b), keyframe=key) for a, b in spans]


# The same bytes


def test_joined_parts_are_the_encode_in_one_go(whole: Path, parts: list[Path], tmp_path: Path) -> None:
    report = join(parts[::-1], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()
    assert (report.parts, report.frames, report.total_bytes) == (3, FRAMES, whole.stat().st_size)
    assert [path.name for path in tmp_path.iterdir()] == ["joined.dgs"]


@pytest.mark.parametrize(
    ("spans", "threads"), [([(0, 7)], 3), ([(0, 4), (4, 7)], 2), ([(0, 2), (2, 4), (4, 6), (6, 7)], 3)]
)
def test_whatever_the_number_of_parts_and_threads(
    make: Make, whole: Path, key: Path, tmp_path: Path, spans: list[tuple[int, int]], threads: int
) -> None:
    made = [make(tmp_path / f"{a}.dgs", (a, b), keyframe=key, threads=threads) for a, b in spans]
    join([key, *made], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()


def test_the_first_part_can_make_the_keyframe(make: Make, whole: Path, parts: list[Path], tmp_path: Path) -> None:
    first = make(tmp_path / "first.dgs", (0, 4))
    last = make(tmp_path / "last.dgs", (4, 7), keyframe=first)
    assert last.read_bytes() == parts[2].read_bytes(), "any part brings the same keyframe"
    join([first, last], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()


def test_detected_effects_are_decided_once(make: Make, settings: EncodeSettings, tmp_path: Path) -> None:
    chosen = {"effects": "auto", "settings": replace(settings, corrections=CorrectionSettings())}
    one = make(tmp_path / "one.dgs", **chosen)
    made = [make(tmp_path / "first.dgs", (0, 2), **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, b), keyframe=made[0], **chosen) for a, b in [(2, 6), (6, 7)]]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_metrics_are_joined_too(make: Make, tmp_path: Path) -> None:
    one = make(tmp_path / "one.dgs", metrics=True)
    with one.open("rb") as file:
        told = [packet.frame for packet in iterate_packets(file) if packet.kind == PacketKind.METRICS]
    assert told == list(range(FRAMES))
    key = make(tmp_path / "key.dgs", (0, 1), metrics=True)
    made = [
        make(tmp_path / f"{a}.dgs", (a, b), keyframe=key, metrics=True, threads=2) for a, b in [(0, 2), (2, 6), (6, 7)]
    ]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


@pytest.mark.parametrize(
    "options",
    [{"switches": Switches("paper")}, {"switches": Switches("3dgstream")}, {"targets": Targets(target_psnr=24.0)}],
    ids=["paper", "3dgstream", "target"],
)
@pytest.mark.parametrize("imported", [False, True], ids=["trained", "imported"])
def test_whatever_method_target_and_keyframe(
    make: Make, moving: Any, moving_rig: Path, tmp_path: Path, options: dict[str, Any], imported: bool
) -> None:
    """Methods that train every Gaussian, or have a cache; Gaussians from a file of another program."""
    chosen, begun = {"rig": moving_rig} | options, {}
    if imported:
        export(moving.path, tmp_path / "key.ply", frames=range(0, 1))
        begun = {"keyframe": tmp_path / "key.ply"}
    one = make(tmp_path / "one.dgs", **begun, **chosen)
    made = [make(tmp_path / "key.dgs", (0, 1), **begun, **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, a + SEGMENT), keyframe=made[0], **chosen) for a in (0, SEGMENT)]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_range_of_the_rig_and_a_keyframe_of_an_earlier_stream(
    make: Make, moving: Any, settings: EncodeSettings, moving_rig: Path, tiny_rig: Any, tmp_path: Path
) -> None:
    chosen = {"rig": moving_rig, "segment": 1, "holdout": [tiny_rig.held_out], "frames": slice(0, 3)}
    one = make(tmp_path / "one.dgs", keyframe=moving.path, **chosen)
    made = [make(tmp_path / "key.dgs", (0, 1), keyframe=moving.path, **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, a + 1), keyframe=made[0], **chosen) for a in (1, 2)]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_take_that_begins_later_counts_its_segments_from_there(make: Make, tmp_path: Path) -> None:
    """Keyframe, cross-fade, metrics and all, from an odd frame with segments of two."""
    chosen = {"frames": slice(1, 6), "metrics": True}
    one = make(tmp_path / "one.dgs", **chosen)
    made = [make(tmp_path / "key.dgs", (1, 2), **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, b), keyframe=made[0], **chosen) for a, b in [(1, 3), (3, 5), (5, 6)]]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_take_of_one_frame_is_a_part_and_joined(make: Make, tmp_path: Path) -> None:
    one = make(tmp_path / "one.dgs", frames=slice(1))
    join([make(tmp_path / "key.dgs", (0, 1), frames=slice(1))], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_part_reads_the_first_frame_its_own_and_the_next_start(
    make: Make, rig: Path, key: Path, parts: list[Path], tmp_path: Path
) -> None:
    spoilt = Path(shutil.copytree(rig, tmp_path / "rig"))
    for camera in spoilt.glob("cam*"):
        for number in (1, 5, 6):
            (camera / f"{number:04d}.png").write_bytes(b"no picture")
    made = make(tmp_path / "part.dgs", (2, 4), keyframe=key, rig=spoilt)
    assert made.read_bytes() == parts[1].read_bytes()


def test_a_part_is_a_stream_that_shows_its_frames(whole: Path, parts: list[Path]) -> None:
    with open_stream(whole) as stream:
        states = [frame.state for frame in stream.frames()]
    for path, places in zip(parts, ([0, 1], [0, 2, 3], [0, 4, 5, 6]), strict=True):
        with open_stream(path) as stream:
            assert stream.complete
            for frame, place in zip(stream.frames(), places, strict=True):
                np.testing.assert_array_equal(frame.state.hashes, states[place].hashes)


# Again


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
    line = "import sys; from decogs.encoder.commands import join_main; sys.exit(join_main())"
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


# What is refused


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"only": (1, 4)}, "`only` 1:4: a part begins where a segment does, such as at 0 or 2"),
        ({"only": (2, 5)}, "`only` 2:5: a part ends where a segment does, such as at 6"),
        ({"only": (8, 9)}, "`only`: there is no such part; the take has frames 0 to 6"),
        ({"only": (2, 4), "closed": False}, "`only`: parts are made of closed segments; add `segment` and `closed`"),
        ({"only": (2, 4), "resume": True}, "`resume`: a part is encoded whole or not at all"),
        ({"only": (2, 4)}, "`only` 2:4: parts after the first start from its keyframe; make one with `only` 0:1"),
    ],
)
def test_what_is_no_part(make: Make, tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", options.pop("only"), **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": 3}, "key.dgs: it was begun with seed 0, this encode has 3"),
        ({"holdout": ["cam03"]}, "key.dgs: it was made from other input"),
        ({"segment": 4, "only": (4, 7)}, r"key.dgs: it was begun with segment 2, this encode has 4 \(`segment`\)"),
        ({"targets": Targets(quality=60)}, "key.dgs: it was begun with frame.significance.threshold"),
        ({"frames": slice(0, 6), "only": (4, 6)}, "key.dgs: it is a part of frames 0 to 6, not of frames 0 to 5"),
        ({"effects": EffectChoice("none", {"motion"})}, "key.dgs: it was begun with other effects"),
        ({"effects": EffectChoice("none", set(PRESET_EFFECTS))}, "key.dgs: it was begun with other effects"),
    ],
)
def test_parts_have_the_options_of_their_keyframe(
    make: Make, key: Path, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", options.pop("only", (4, 7)), keyframe=key, **options)
    assert not list(tmp_path.iterdir())


def test_parts_have_the_pictures_and_releases_of_their_keyframe(
    make: Make, rig: Path, key: Path, tiny_rig: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = tiny_rig.poisoned(rig, tmp_path / "rig", "cam03")
    with pytest.raises(UsageError, match="it was made from other input: the picture content of frame 0 differs"):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key, rig=other)
    monkeypatch.setattr(np, "__version__", "1.0")
    with pytest.raises(UsageError, match=rf"it was made with numpy {np.version.version}, not 1.0"):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key)


@pytest.mark.parametrize(
    "change", [{"effects": ("motion",)}, {"detect_per_frame": False}, {"corrections": CorrectionSettings()}]
)
def test_parts_have_the_effects_of_their_keyframe(
    make: Make, settings: EncodeSettings, key: Path, tmp_path: Path, change: dict[str, Any]
) -> None:
    """Where the settings say which, and nothing is detected."""
    message = "key.dgs: it was begun with (effects|detect_per_frame|corrections)"
    with pytest.raises(UsageError, match=message):
        make(tmp_path / "part.dgs", (4, 7), keyframe=key, settings=replace(settings, **change))


def test_parts_have_the_device_of_their_keyframe() -> None:
    """Since a GPU gives other bits; "auto" is the processor."""
    cpu, auto, cuda = (Part(range(2), range(4), {}, "", made_with(device)) for device in ("cpu", "auto", "cuda"))
    assert cpu.difference(auto) == ""
    assert cpu.difference(cuda) == "it was made with device cpu, not cuda"


def cut(path: Path, copy: Path, change: Callable[[bytearray], Any]) -> Path:
    data = bytearray(path.read_bytes())
    change(data)
    copy.write_bytes(data)
    return copy


def test_lost_and_doubled_parts_are_named(parts: list[Path], tmp_path: Path) -> None:
    for given, message in (
        (parts[1:], "`parts`: none of them has frames 0 to 1; encode a part with `only` 0:2"),
        (parts[:2], "`parts`: none of them has frames 4 to 6; encode a part with `only` 4:7"),
        ([parts[0], parts[2]], "`parts`: none of them has frames 2 to 3"),
        (
            [*parts, parts[1]],
            "2-4.dgs: it has frames 2 to 3, which .*2-4.dgs has as well; leave out one of the two",
        ),
    ):
        refused(given, tmp_path, message)


def test_damaged_parts_are_named(parts: list[Path], tmp_path: Path) -> None:
    with parts[1].open("rb") as file:
        own = next(p for p in iterate_packets(file) if p.kind == PacketKind.KEY and p.frame == 1)

    def flip(data: bytearray) -> None:
        data[own.offset + 40] ^= 1

    def shorten(data: bytearray) -> None:
        del data[own.offset + own.size :]

    for change in (flip, shorten, lambda data: data.__setitem__(slice(5, 6), b"!")):
        damaged = cut(parts[1], tmp_path / "damaged.dgs", change)
        refused([parts[0], damaged, parts[2]], tmp_path, r"damaged.dgs: the part is damaged \(.*\); encode it again")
        damaged.unlink()


def rewritten(
    path: Path, copy: Path, *, frames: Sequence[int] | None = None, first: Callable[[bytes], bytes] = bytes
) -> Path:
    """A part as a whole stream, with other ``frames`` in its manifest or another ``first`` keyframe."""
    with path.open("rb") as file, copy.open("wb") as other:
        header, *packets = iterate_packets(file)
        known = StreamHeader.from_bytes(header.payload)
        manifest = known.settings["part"] | ({} if frames is None else {"frames": list(frames)})
        writer = StreamWriter(other, replace(known, settings={**known.settings, "part": manifest}).to_bytes())
        for packet in packets:
            if packet.kind in FRAME_KINDS:
                writer.write(packet.kind, packet.frame, packet.payload if packet.frame else first(packet.payload))
        writer.finish()
    return copy


@pytest.mark.parametrize(
    ("given", "frames", "problem"),
    [
        (1, (2, 6), "3 of its 5 frame packets are there"),
        (1, (2, 3), "3 of its 2 frame packets are there"),
        (0, (1, 2), "it does not begin with a keyframe"),
    ],
)
def test_parts_that_are_not_what_their_manifest_says_are_named(
    parts: list[Path], tmp_path: Path, given: int, frames: tuple[int, int], problem: str
) -> None:
    other = rewritten(parts[given], tmp_path / "other.dgs", frames=frames)
    refused([other], tmp_path, rf"other.dgs: the part is damaged \({problem}\); encode it again")


@pytest.mark.parametrize("frame", [0, 2, MAX_FRAME])
def test_metrics_of_another_frame_are_named(parts: list[Path], tmp_path: Path, frame: int) -> None:
    """Behind the part's frame 1; the last one would have a number that no packet has in the joined stream."""
    with parts[1].open("rb") as file, (tmp_path / "other.dgs").open("wb") as other:
        header, key, mine, *_ = iterate_packets(file)
        writer = StreamWriter(other, header.payload)
        for packet, number in ((key, 0), (mine, 1)):
            writer.write(packet.kind, number, packet.payload)
        writer.write(PacketKind.METRICS, frame, b"{}")
    problem = f"frame {frame} where frame 1 must come"
    refused([tmp_path / "other.dgs"], tmp_path, rf"other.dgs: the part is damaged \({problem}.*\); encode it again")


def test_parts_that_begin_with_other_keyframes_are_named(parts: list[Path], tmp_path: Path) -> None:
    """As a GPU trains them, other ones every time: all else is the same."""
    other = rewritten(parts[1], tmp_path / "other.dgs", first=lambda payload: payload[:-1] + b"!")
    refused([parts[0], other, parts[2]], tmp_path, "other.dgs: it does not .*: it starts from another first keyframe")


def test_foreign_parts_are_named(
    make: Make, whole: Path, parts: list[Path], rig: Path, settings: EncodeSettings, tiny_rig: Any, tmp_path: Path
) -> None:
    own = tmp_path / "own"
    own.mkdir()
    foreign = {
        "seed": (make(own / "seed.dgs", (0, 2), seed=1), "was begun with seed 1, the other part has 0"),
        "take": (
            make(own / "take.dgs", (0, 2), frames=slice(0, 6)),
            "it is a part of frames 0 to 5, not of frames 0 to 6",
        ),
        "metrics": (make(own / "metrics.dgs", (0, 2), metrics=True), "it was made with `metrics`"),
        "rig": (
            make(own / "rig.dgs", (0, 2), rig=tiny_rig.poisoned(rig, own / "rig", "cam03")),
            "it was made from other input: the picture content of frame 0 differs",
        ),
    }
    for name, (path, problem) in foreign.items():
        refused(
            [parts[1], path, parts[2]], tmp_path / "out", rf"{name}.dgs: it does not belong to .*2-4.dgs: {problem}"
        )
    refused([whole, *parts], tmp_path / "out", "scene.dgs: this is no part of a take")
    refused([tmp_path / "none.dgs"], tmp_path / "out", "none.dgs: No such file or directory")


def refused(parts: Sequence[Path], folder: Path, message: str) -> None:
    folder.mkdir(exist_ok=True)
    before = sorted(folder.iterdir())
    with pytest.raises(UsageError, match=message) as raised:
        join(parts, folder / "joined.dgs")
    assert "\n" not in str(raised.value)
    assert sorted(folder.iterdir()) == before


def test_a_part_is_never_written_over(parts: list[Path], tmp_path: Path) -> None:
    copies = [Path(shutil.copy(path, tmp_path)) for path in parts]
    with pytest.raises(UsageError, match="is read, as one of the parts"):
        join(copies, copies[1])
    assert copies[1].read_bytes() == parts[1].read_bytes()


# Manifest and settings


@pytest.mark.parametrize(
    "spoil",
    [
        lambda part: None,
        lambda part: [],
        lambda part: {},
        lambda part: part | {"frames": [4, 2]},
        lambda part: part | {"frames": [2, 4.5]},
        lambda part: part | {"frames": [2, 1 << 40]},
        lambda part: part | {"take": [0, 3]},
        lambda part: part | {"take": [1, 7]},
        lambda part: part | {"take": "0:7"},
        lambda part: part | {"inputs": {"a": 1}},
        lambda part: part | {"made_with": None},
        lambda part: part | {"recorded": 3},
        lambda part: part | {"metrics": 1},
    ],
)
def test_manifests_from_strangers(parts: list[Path], spoil: Callable[[Any], Any]) -> None:
    with open_stream(parts[1]) as stream:
        header = stream.header
    assert read_part(header) is not None
    spoilt = replace(header, settings={**header.settings, "part": spoil(header.settings["part"])})
    assert read_part(spoilt) is None


def test_negative_and_open_ends(tmp_path: Path) -> None:
    assert part_frames(slice(-3, None), range(7), 2) == range(4, 7)
    assert part_frames(slice(13, None), range(3, 20), 5) == range(13, 20)


@pytest.mark.parametrize("name", list(PRESETS))
def test_settings_are_read_as_they_were_written(name: str) -> None:
    corrections = CorrectionSettings(exposure=("a", "b"), lens={"a": 0.1}, match_colours=True)
    written = replace(PRESETS[name], segment=5, closed=True, corrections=corrections, effects=("motion",))
    assert read_settings(written.as_document() | {"seed": 3}) == written


def test_what_the_keyframe_cost_is_not_paid_again(
    make: Make, settings: EncodeSettings, key: Path, tmp_path: Path
) -> None:
    """It does not matter to a part with what settings it would have been trained."""
    other = replace(settings, keyframe=replace(settings.keyframe, iterations=300), lattice_scale=2.0)
    made = [make(tmp_path / f"{n}.dgs", (6, 7), keyframe=key, settings=s) for n, s in enumerate((settings, other))]
    assert made[0].read_bytes() == made[1].read_bytes()
