"""Files of the PyPI package splats4d, which its command reads; a fake of it stands for what the package may do."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from decogs.formats.errors import UsageError
from decogs.formats.splat_files import Room
from decogs.formats.splat_files.quantised import opacities
from decogs.formats.splat_files.splat import Splat, records
from decogs.formats.splat_sequences import splat4d
from decogs.formats.splat_sequences.opening import open_sequence
from decogs.formats.splats import Splats
from random_splats import random_splats

FAKE = f"""#!{sys.executable}
import json, pathlib, sys
whole = pathlib.Path(sys.argv[2]).read_bytes()
head, _, rest = whole.partition(b"\\n")
if sys.argv[1] == "info":
    print(head.decode() + "\\nfile 1.5 KB")
else:
    facts, k = json.loads(head), int(sys.argv[sys.argv.index("--frame") + 1])
    size = len(rest) // facts["t"]
    pathlib.Path(sys.argv[sys.argv.index("-o") + 1]).write_bytes(rest[k * size : (k + 1) * size])
"""


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A ``splat4d`` whose files are a line of what `info` says, and .splat files one behind the other."""
    command = tmp_path / "bin" / "splat4d"
    command.parent.mkdir()
    command.write_text(FAKE)
    command.chmod(0o755)
    monkeypatch.setenv("PATH", str(command.parent))
    return command


def frames() -> list[Splats]:
    """Three of six Gaussians, of which the first is not there in the second."""
    tables = [records(random_splats(6, 1)) for _ in range(3)]
    tables[1]["opacity"][0] = 0
    return [Splat().decode(table.tobytes()) for table in tables]


def faked(path: Path, **facts: object) -> Path:
    tables = [records(splats) for splats in frames()]
    tables[1]["opacity"][0] = 0
    says = {"n": 6, "t": 3, "fps": 24.0, **facts}
    path.write_bytes(json.dumps(says).encode() + b"\n" + b"".join(table.tobytes() for table in tables))
    return path


@pytest.mark.parametrize(("fps", "expected"), [(None, 24), (30, 30)])
def test_rows_are_the_same_gaussians_and_those_of_opacity_0_are_not_there(
    fake: Path, tmp_path: Path, fps: float | None, expected: float
) -> None:
    sequence = open_sequence(faked(tmp_path / "a.splat4d"), Room(), fps)
    assert (sequence.fps, sequence.frame_count) == (expected, 3)
    assert [frame.ids.tolist() for frame in sequence.frames()] == [[*range(6)], [*range(1, 6)], [*range(6)]]
    for frame, splats in zip(sequence.frames(), frames(), strict=True):
        np.testing.assert_array_equal(frame.splats.means, splats.means[frame.ids])


def test_what_its_header_says_is_checked_before_anything_is_unpacked(fake: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.splat4d"
    for facts, says in (
        ({"n": 1 << 40}, "holds 1099511627776 Gaussians, which take .*`max_memory`"),
        ({"n": 5}, "frame 0 has 192 bytes, which are not 5 Gaussians"),
        ({"t": -1}, "does not say what it holds; write it again"),
        ({"n": "6"}, "does not say what it holds; write it again"),
        ({"fps": 0}, "does not say what it holds; write it again"),
        ({"fps": None}, "does not say what it holds; write it again"),
    ):
        with pytest.raises(UsageError, match=rf"a\.splat4d: {says}") as caught:
            list(open_sequence(faked(path, **facts), Room(memory=1 << 30)).frames())
        assert "\n" not in str(caught.value)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory of a process")
def test_the_command_gets_no_more_memory_than_a_frame_may_take(fake: Path, tmp_path: Path) -> None:
    path = faked(tmp_path / "a.splat4d")
    fake.write_text(f"#!{sys.executable}\nimport resource\nprint(resource.getrlimit(resource.RLIMIT_AS)[0])\n")
    assert splat4d.run_splat4d("info", str(path), memory=1 << 31) == f"{1 << 31}\n"


def test_the_reason_that_it_gives_is_one_line(fake: Path, tmp_path: Path) -> None:
    path = faked(tmp_path / "a.splat4d")
    for stderr, says in (
        ("Error: not a .splat4d file (bad magic)\n\nStack backtrace:\n", "Error: not a .splat4d file"),
        ("\nthread 'main' panicked at src/decode.rs:57:58:\nrange end index 625\n", "range end index 625"),
        ("", "no reason given"),
    ):
        fake.write_text(f"#!{sys.executable}\nimport sys\nsys.exit({stderr!r} or 1)\n")
        with pytest.raises(UsageError, match=rf"a\.splat4d: splat4d info: {says}") as caught:
            open_sequence(path, Room())
        assert "\n" not in str(caught.value)


def test_without_the_package_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splat4d, "splat4d_command", lambda: None)
    with pytest.raises(UsageError, match=r"a\.splat4d: .*not installed: pip install splats4d$"):
        open_sequence(faked(tmp_path / "a.splat4d"), Room())


@pytest.mark.skipif(splat4d.splat4d_command() is None, reason="needs the PyPI package splats4d")
def test_a_real_file_is_read_and_a_damaged_one_is_one_line(tmp_path: Path) -> None:
    series, path = tmp_path / "series", tmp_path / "a.splat4d"
    series.mkdir()
    shown = frames()
    for number, splats in enumerate(shown):
        (series / f"frame_{number:04d}.splat").write_bytes(Splat().encode(splats))
    splat4d.run_splat4d("encode", "-i", str(series), "-o", str(path), "--fps", "12")
    sequence = open_sequence(path, Room(memory=1 << 30))
    assert (sequence.fps, sequence.frame_count) == (12, 3)
    for frame, splats in zip(sequence.frames(), shown, strict=True):
        nearest = np.linalg.norm(frame.splats.means[:, None] - splats.means[None], axis=2).min(axis=1)
        assert nearest.max() <= np.sqrt(3) * 0.002 * 1.001
        assert opacities(frame.splats).min() > 0
    data = path.read_bytes()
    for size in (3, 20, len(data) // 2, len(data) - 5):
        path.write_bytes(data[:size])
        with pytest.raises(UsageError, match=r"a\.splat4d: splat4d (info|decode): ") as caught:
            list(open_sequence(path, Room(memory=1 << 30)).frames())
        assert "\n" not in str(caught.value)
