"""What a container says beside its packets: frames that an edit list hides, and colours that are not sRGB's."""

from __future__ import annotations

import os
import resource
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from decogs.formats.errors import RigError
from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.video_tags import read_tags
from decogs.formats.videos import open_video


def trimmed(mp4: bytes, *, hidden: int, frames: int) -> bytes:
    """The file with an edit list that shows all but the first ``hidden`` of its frames, as ``ffmpeg -ss`` leaves it."""
    data = bytearray(mp4)
    media, edits = data.index(b"mdhd"), data.index(b"elst")
    (lasting,) = struct.unpack_from(">I", data, media + 20)
    duration, begin = struct.unpack_from(">Ii", data, edits + 12)
    kept = (frames - hidden) / frames
    struct.pack_into(">Ii", data, edits + 12, round(duration * kept), begin + hidden * lasting // frames)
    return bytes(data)


def coloured(mp4: bytes, primaries: int, transfer: int) -> bytes:
    """The file with a colour box in its track; ``moov`` comes last, so that no offset changes."""
    box = struct.pack(">I4s4sHHHB", 19, b"colr", b"nclx", primaries, transfer, 9, 0)
    data = bytearray(mp4)
    for kind in (b"moov", b"trak"):
        at = data.index(kind) - 4
        (size,) = struct.unpack_from(">I", data, at)
        struct.pack_into(">I", data, at, size + len(box))
        end = at + size
    return bytes(data[:end] + box + data[end:])


def test_frames_that_an_edit_list_hides_are_not_counted(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "cam.mp4"
    make.video(path, frames=30)
    whole = path.read_bytes()
    pictures = list(open_video(path).read(0, 30))
    path.write_bytes(trimmed(whole, hidden=7, frames=30))
    video = open_video(path)
    assert (video.frame_count, video.fps) == (23, 30)
    shown = list(video.read(0, video.frame_count))
    assert all((ours == theirs).all() for ours, theirs in zip(shown, pictures[7:], strict=True))
    path.write_bytes(trimmed(whole, hidden=0, frames=30))
    assert open_video(path).frame_count == 30


def test_a_rig_of_which_one_video_hides_frames_is_refused(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "rig")
    path = rig / "cam01.mp4"
    path.write_bytes(trimmed(path.read_bytes(), hidden=2, frames=make.frames))
    with pytest.raises(RigError, match=rf"cam01\.mp4: {make.frames - 2} frames, but cam00\.mp4 has {make.frames}"):
        open_rig(rig)


def test_colours_that_are_not_srgb_are_warned_of(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "rig")
    recorded = {path: path.read_bytes() for path in rig.glob("*.mp4")}
    tags = ((9, 16, "PQ, BT.2020"), (9, 18, "HLG, BT.2020"), (1, 8, "linear light"), (12, 13, "Display P3"), (1, 1, ""))
    for primaries, transfer, said in tags:
        for path, data in recorded.items():
            path.write_bytes(coloured(data, primaries, transfer))
        opened = open_rig(rig)
        expected = f"cam00.mp4 and 2 more: its colours are tagged {said}, and FFmpeg" if said else ""
        assert len(opened.warnings) == bool(said)
        assert expected in "".join(opened.warnings)
        # FFmpeg 8 takes seconds for the first picture of another gamut: one of them stands for all.
        if primaries == 12:
            assert [picture.shape for _, (picture,) in read_frames(opened, 0, 1, names=["cam00"])]


def test_matroska_says_its_colours_before_its_first_cluster(tmp_path: Path) -> None:
    path = tmp_path / "cam.mkv"
    path.write_bytes(b"\x1aE\xdf\xa3..\x55\xba\x81\x10..\x55\xbb\x81\x09..\x1f\x43\xb6\x75..")
    assert read_tags(path).colours == "PQ, BT.2020"
    path.write_bytes(b"\x1aE\xdf\xa3..\x1f\x43\xb6\x75..\x55\xba\x81\x10")
    assert read_tags(path).colours == ""


def test_damaged_boxes_say_nothing(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "cam.mp4"
    make.video(path)
    data = coloured(path.read_bytes(), 9, 16)
    start = data.index(b"moov") - 4
    for at in range(start, len(data), 7):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        read_tags(path)
        path.write_bytes(data[:at])
        read_tags(path)


def test_rates_that_differ_by_little_are_warned_of(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "rig")
    assert open_rig(rig).warnings == ()
    make.video(rig / "cam01.mp4", fps=30000 / 1001)
    (warning,) = open_rig(rig).warnings
    assert "cam01.mp4: 29.970 frames per second, but cam00.mp4 has 30.000; frames of one number are taken as" in warning


def test_too_many_open_files_are_called_so(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path / "rig", cameras=8))
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    for spare in range(3, 8):
        first_free = os.open(os.devnull, os.O_RDONLY)
        os.close(first_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (first_free + spare, hard))
        try:
            with pytest.raises(
                RigError, match=r"cam0\d\.mp4: cannot be read \(Too many open files\); allow more, by ulim"
            ):
                next(read_frames(rig))
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_path_that_is_not_utf8_is_an_error_and_not_a_crash(tmp_path: Path, make: Any) -> None:
    """In a process of its own, since OpenCV dies of it."""
    rig = make.n3dv(tmp_path / "rig")
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/rig\xff"))
    try:
        rig.rename(odd)
    except OSError:
        pytest.skip("this file system takes names in UTF-8 only")
    code = "import sys; from decogs.formats.rigs import open_rig; open_rig(sys.argv[1])"
    ran = subprocess.run([sys.executable, "-c", code, odd], capture_output=True, text=True, errors="replace")
    assert ran.returncode == 1
    assert "its path is not UTF-8, so no video in it can be opened; rename it" in ran.stderr


def test_a_path_in_utf8_is_read_whatever_the_locale(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "Bühne")
    plain = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = "import sys; from decogs.formats.rigs import open_rig; print(open_rig(sys.argv[1]).frame_count)"
    ran = subprocess.run([sys.executable, "-c", code, rig], capture_output=True, text=True, env=os.environ | plain)
    assert (ran.stdout, ran.returncode) == (f"{make.frames}\n", 0), ran.stderr
