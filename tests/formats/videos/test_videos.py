"""Videos: every frame in order as FFmpeg shows it, far ones by a seek that is checked, and damage found where it is."""

from __future__ import annotations

import os
import re
import resource
import struct
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import av.filter
import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.errors import RigError
from decogs.formats.rigs import Rig, open_rig, read_frames
from decogs.formats.videos import reading as videos
from decogs.formats.videos.reading import VideoSource, open_video
from textured_videos import X264, long_video, texture, with_matrix, write

CODEC_TOLERANCE = 4
"""MPEG-4 part 2 at OpenCV's default rate keeps a flat colour within 4 of 255 steps, limited range included."""


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by one for each frame that is decoded."""
    log: list[int] = []
    real = videos._decoded

    def logged(*arguments: Any, **options: Any) -> Iterator[Any]:
        for frame in real(*arguments, **options):
            log.append(1)
            yield frame

    monkeypatch.setattr(videos, "_decoded", logged)
    return log


def test_size_count_and_rate(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=7, size=(80, 60), fps=25)
    source = open_video(tmp_path / "a.mp4")
    assert (source.width, source.height, source.frame_count, source.fps) == (80, 60, 7, 25.0)
    np.testing.assert_array_equal(np.diff(source.times), np.diff(source.times)[0])


def test_frames_come_in_order_as_rgb(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=6)
    frames = list(open_video(tmp_path / "a.mp4").read(0, 6))
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 6
    for k, frame in enumerate(frames):
        assert frame.dtype == np.uint8
        expected = np.array([40, 30, 20]) + 20 * k
        np.testing.assert_allclose(frame.mean(axis=(0, 1)), expected, atol=CODEC_TOLERANCE)


def test_only_what_is_asked_for_is_handed_out(tmp_path: Path, make: Any, decoded: list[int]) -> None:
    make.video(tmp_path / "a.mp4", frames=9)
    source = open_video(tmp_path / "a.mp4")
    whole = list(source.read(0, 9))
    np.testing.assert_array_equal(list(source.read(5, 7)), whole[5:7])
    np.testing.assert_array_equal(list(source.read(2, 7, 3)), [whole[2], whole[5]])
    decoded.clear()
    reader = source.read(0, 9)
    for taken in (1, 2, 3):
        next(reader)
        assert len(decoded) == taken


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("closed.mp4", {"g": "25", "bf": "3"}),
        ("open.mp4", {"x264-params": "open-gop=1:keyint=40:bframes=5:b-pyramid=normal:log-level=none"}),
        ("refresh.mp4", {"x264-params": "intra-refresh=1:keyint=30:bframes=0:log-level=none"}),
        ("one.mkv", {"g": "1000", "bf": "2"}),
    ],
)
def test_a_far_start_is_sought(tmp_path: Path, decoded: list[int], name: str, options: dict[str, str]) -> None:
    source = long_video(tmp_path / name, **options)
    whole = list(source.read(0, 200))
    for start in (64, 99, 120, 161, 199):
        decoded.clear()
        np.testing.assert_array_equal(list(source.read(start, min(start + 3, 200))), whole[start : start + 3])
        if name != "refresh.mp4":  # which has one keyframe
            assert len(decoded) <= 45 or name == "one.mkv"


@pytest.mark.parametrize("lands", [0, 199])
def test_a_seek_that_lands_elsewhere_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lands: int) -> None:
    source = long_video(tmp_path / "a.mp4", g="25")
    whole = list(source.read(0, 125))
    real = videos._seek
    asked: list[int] = []

    def elsewhere(container: Any, stream: Any, time: int) -> bool:
        asked.append(time)
        return real(container, stream, int(source.times[lands]))

    monkeypatch.setattr(videos, "_seek", elsewhere)
    np.testing.assert_array_equal(list(source.read(120, 123)), whole[120:123])
    assert asked


def test_a_container_that_cannot_seek_is_read_from_its_beginning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = long_video(tmp_path / "a.mp4", g="25")
    whole = list(source.read(0, 125))
    monkeypatch.setattr(videos, "_seek", lambda *arguments: False)
    np.testing.assert_array_equal(list(source.read(120, 123)), whole[120:123])


def test_variable_rate_is_refused_with_the_frame(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "cam03.mp4"
    make.video(path, frames=6, fps=30)
    whole = path.read_bytes()
    # OpenCV's mp4 has 512 time units per frame. Equal durations leave the file as it was: the patch itself is sound.
    path.write_bytes(make.with_frame_durations(whole, [512] * 6))
    np.testing.assert_array_equal(open_video(path).times, np.arange(6) * 512)
    path.write_bytes(make.with_frame_durations(whole, [512, 512, 1024, 512, 512, 512]))
    with pytest.raises(RigError, match=r"cam03\.mp4: variable frame rate .*frame 2 lasts 66\.7 ms, most last 33\.3 ms"):
        open_video(path)


def test_rounded_time_stamps_are_no_variable_rate(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "a.mp4"
    make.video(path, frames=6, fps=30)
    # What a Matroska file at 30 fps looks like: 33, 34, 33 ms.
    path.write_bytes(make.with_frame_durations(path.read_bytes(), [507, 522, 507, 507, 522, 507]))
    assert open_video(path).frame_count == 6


def test_a_frame_dropped_by_the_decoder_is_named(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=6)
    source = open_video(tmp_path / "a.mp4")
    # Frames that do not come at their packets' times, as after one that could not be decoded.
    wrong = replace(source, frame_count=5, times=np.delete(source.times, 3))
    reader = wrong.read(0, 5)
    assert [next(reader).shape for _ in range(3)] == [(48, 64, 3)] * 3
    with pytest.raises(RigError, match=r"a\.mp4: frame 3 is damaged or missing"):
        list(reader)


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv", "a.ts", "a.avi"])
def test_damage_costs_the_frames_up_to_the_next_keyframe(tmp_path: Path, name: str) -> None:
    """Wherever reading starts: what is predicted from a damaged frame is damaged; a rig reads the others."""
    write(tmp_path / name, "mpeg4", frames=12, options={"g": "5", "b": "4M"})
    whole = list(open_video(tmp_path / name).read(0, 12))
    damage_packet(tmp_path / name, 6)
    source = open_video(tmp_path / name)
    assert source.frame_count == 12
    for start in (0, 5, 6, 7, 9, 10, 11):
        for index, picture in read_what_can_be(source, start).items():
            np.testing.assert_array_equal(picture, whole[index])
    assert list(read_what_can_be(source, 0)) == [0, 1, 2, 3, 4, 5, 10, 11]
    assert list(read_what_can_be(source, 8)) == [10, 11]


def damage_packet(path: Path, index: int) -> None:
    with av.open(str(path)) as container:
        data = [bytes(packet) for packet in container.demux(video=0) if packet.size][index]
    whole = path.read_bytes()
    middle = data[len(data) // 3 : len(data) // 3 + 60]
    assert whole.count(middle) == 1
    path.write_bytes(whole.replace(middle, b"U" * len(middle)))


def read_what_can_be(source: VideoSource, start: int) -> dict[int, np.ndarray]:
    """The frames from ``start`` on as a rig reads them, without those that are lost."""
    camera = Camera("a", source.width, source.height, 50, 50, 32, 24, np.eye(4))
    rig = Rig(source.path, "one", (camera,), (source,), None, source.frame_count)
    lost: list[int] = []
    frames = read_frames(rig, start, on_lost=lambda index, name, error: lost.append(index))
    return {index: picture for index, (picture,) in frames if index not in lost}


def test_early_end_names_file_and_frame(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=4)
    longer = replace(open_video(tmp_path / "a.mp4"), frame_count=6, times=None)
    with pytest.raises(RigError, match=r"a\.mp4: the video ends or is damaged at frame 4 .* announces 6 frames"):
        list(longer.read(0, 6))


def test_every_truncation_is_found_quietly(tmp_path: Path, make: Any, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "cam05.mp4"
    make.video(path, frames=12)
    data = path.read_bytes()
    capfd.readouterr()
    for length in range(0, len(data) - 1, 97):
        path.write_bytes(data[:length])
        with pytest.raises(RigError, match=r"cam05\.mp4: ") as caught:
            open_video(path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_endless_frames_are_not_listed(tmp_path: Path, make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables of a small file can claim the same bytes as millions of frames."""
    make.video(tmp_path / "a.mp4", frames=6)
    monkeypatch.setattr(videos, "_MAX_FRAMES", 5)
    with pytest.raises(RigError, match=r"a\.mp4: the video claims more than 5 frames"):
        open_video(tmp_path / "a.mp4")
    monkeypatch.setattr(videos, "_MAX_FRAMES", 6)
    assert open_video(tmp_path / "a.mp4").frame_count == 6


def test_notes_that_a_camera_appends_are_no_truncation(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4")
    with (tmp_path / "a.mp4").open("ab") as file:
        file.write(b"made by camera 7, lens 12" * 10)
    assert len(list(open_video(tmp_path / "a.mp4").read(0, 6))) == 6


@pytest.mark.parametrize("name", ["a.ts", "a.avi", "a.mkv", "a.mxf"])
def test_a_stream_that_ends_early_is_found_when_it_is_opened(tmp_path: Path, name: str) -> None:
    """Or it has so many frames less, which the comparison with other cameras finds."""
    path = tmp_path / name
    shown = write(path, *(("mpeg2video",) if name == "a.mxf" else ()), frames=12, options={"b": "4M", "g": "4"})
    data = path.read_bytes()
    for share in (0.95, 0.7, 0.4):
        path.write_bytes(data[: int(share * len(data))])
        try:
            source = open_video(path)
        except RigError as error:
            said = str(error)
            assert re.search("truncated|damaged|missing frames|no video", said)
        else:
            assert source.frame_count < len(shown) or name == "a.mxf"  # which ends with a table that nobody needs
            assert len(list(source.read(0, source.frame_count))) == source.frame_count


def test_flipped_bytes_never_leak_another_exception(
    tmp_path: Path, make: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.mp4"
    make.video(path, frames=6)
    data, rng, refused = path.read_bytes(), np.random.default_rng(3), 0
    capfd.readouterr()
    for _ in range(60):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), 8):
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            source = open_video(path)
            for _ in source.read(0, min(source.frame_count, 20)):
                pass
        except RigError:
            refused += 1
    assert refused > 0
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("content", [b"", b"no video at all " * 100])
def test_no_video(tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(RigError, match=r"a\.mp4: the file is no video"):
        open_video(tmp_path / "a.mp4")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_file_is_not_waited_for(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "a.mp4"
    {"pipe": lambda: os.mkfifo(path), "device": lambda: path.symlink_to("/dev/zero"), "folder": path.mkdir}[kind]()
    with pytest.raises(RigError, match=r"a\.mp4: is no regular file"):
        open_video(path)


def test_missing_video(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"gone\.mp4: the video is missing"):
        open_video(tmp_path / "gone.mp4")


@pytest.mark.parametrize("text", ["ffconcat version 1.0\nfile real.mp4\n", "#EXTM3U\n#EXTINF:1,\nreal.mp4\n"])
def test_a_list_of_other_files_is_no_video(tmp_path: Path, make: Any, text: str) -> None:
    make.video(tmp_path / "real.mp4")
    (tmp_path / "cam00.mp4").write_text(text)
    with pytest.raises(RigError, match=r"cam00\.mp4: the file is no video"):
        open_video(tmp_path / "cam00.mp4")


def test_reordered_frames_of_the_sample_rig() -> None:
    """H.264 with B-frames: packets are not in order of presentation (the box ctts says so), frames are."""
    path = Path(__file__).parents[2] / "demo" / "workbench" / "cam01.mp4"
    assert b"ctts" in path.read_bytes()
    source = open_video(path)
    assert (source.frame_count, source.fps, source.width, source.height) == (9, 30.0, 352, 264)
    with av.open(str(path)) as container:
        expected = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    frames = list(source.read(0, 9))
    for t, frame in enumerate(frames):
        off = [np.abs(frame.astype(float) - other).mean() for other in expected]
        assert np.argmin(off) == t


KINDS = {
    "cam.mp4": ("libx264", "yuv420p", {}),
    "cam.MTS": ("libx264", "yuv420p", {"kind": "mpegts"}),
    "cam.m2ts": ("libx264", "yuv422p10le", {"kind": "mpegts"}),
    "cam.mxf": ("mpeg2video", "yuv422p", {"options": {"b": "20M"}}),
    "cam.mpg": ("mpeg2video", "yuv420p", {"kind": "mpeg", "options": {"b": "8M"}}),
    "cam.mov": ("prores_ks", "yuv422p10le", {"options": {}}),
    "film.mov": ("prores_ks", "yuva444p10le", {"options": {"profile": "4444"}}),
    "hevc.mp4": ("libx265", "yuv420p10le", {"options": {"crf": "5", "x265-params": "log-level=none"}}),
    "cam.webm": ("libvpx-vp9", "yuv420p", {"options": {"crf": "5", "b": "0"}}),
    "cam.mkv": ("ffv1", "yuv444p", {"options": {}}),
    "rgb.mkv": ("ffv1", "bgr0", {"options": {}}),
    "av1.mp4": ("libsvtav1", "yuv420p", {"options": {"crf": "5", "preset": "10", "svtav1-params": "lp=1"}}),
    "cam.avi": ("mjpeg", "yuvj420p", {"options": {"qmin": "1", "qmax": "1"}}),
    "dnx.mov": ("dnxhd", "yuv422p", {"options": {"profile": "dnxhr_hq"}, "size": (256, 128)}),
    "cam.y4m": ("rawvideo", "yuv444p", {"kind": "yuv4mpegpipe", "options": {}}),
}


@pytest.mark.parametrize("name", KINDS)
def test_every_usual_codec_is_read_in_order(tmp_path: Path, name: str) -> None:
    codec, pixels, more = KINDS[name]
    shown = write(tmp_path / name, codec, pixels, **more)
    source = open_video(tmp_path / name)
    assert source.frame_count == len(shown)
    for t, picture in enumerate(source.read(0, len(shown))):
        off = [np.abs(picture.astype(float) - other).mean() for other in shown]
        assert int(np.argmin(off)) == t
        assert off[t] < (5 if codec == "dnxhd" else 3)  # the codecs' own loss, chroma at half resolution included


def test_a_codec_that_is_not_decoded_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.count(b"avc1") == 2  # in the list of brands, and of the track
    at = data.rindex(b"avc1")
    (tmp_path / "b.mp4").write_bytes(data[:at] + b"apv1" + data[at + 4 :])
    with pytest.raises(RigError, match=r"b\.mp4: .*\bapv"):
        open_video(tmp_path / "b.mp4")


@pytest.mark.parametrize(
    ("name", "codec", "options"),
    [
        ("a.mp4", "libx264", X264 | {"x264-params": "tff=1"}),
        ("a.mpg", "mpeg2video", {"flags": "+ildct+ilme"}),
        ("a.mov", "prores_ks", {"flags": "+ildct"}),
        ("a.mkv", "ffv1", {"flags": "+ildct"}),
    ],
)
def test_interlaced_frames_are_refused_when_the_video_is_opened(
    tmp_path: Path, name: str, codec: str, options: dict[str, str]
) -> None:
    pixels = "yuv422p10le" if codec == "prores_ks" else "yuv420p"
    write(tmp_path / name, codec, pixels, frames=4, options=options, flagged=range(4))
    with pytest.raises(RigError, match=rf"{name}: frame 0 is flagged interlaced; deinterlace the video"):
        open_video(tmp_path / name)


def test_frames_that_become_interlaced_are_refused_when_the_video_is_opened(tmp_path: Path) -> None:
    write(tmp_path / "a.mkv", "ffv1", frames=40, options={"flags": "+ildct"}, flagged=range(20, 40))
    with pytest.raises(RigError, match=r"a\.mkv: frame (2|3)\d is flagged interlaced"):
        open_video(tmp_path / "a.mkv")


def test_one_frame_that_nobody_saw_when_opening_stops_the_reading(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a.mkv", "ffv1", frames=40, options={"flags": "+ildct"}, flagged=range(3, 4))
    source = open_video(tmp_path / "a.mkv")
    reader = source.read(0, 40)
    assert sum(1 for _ in zip(range(3), reader, strict=False)) == 3
    with pytest.raises(RigError, match=r"a\.mkv: frame 3 is flagged interlaced"):
        next(reader)


def test_columns_that_the_stream_crops_are_not_shown(tmp_path: Path) -> None:
    shown = write(tmp_path / "whole.mp4", frames=2)
    with av.open(str(tmp_path / "whole.mp4")) as whole, av.open(str(tmp_path / "a.mp4"), "w") as copy:
        source = whole.streams.video[0]
        target = copy.add_stream_from_template(source)
        crop = av.BitStreamFilterContext("h264_metadata=crop_left=10:crop_right=6:crop_top=4", source, target)
        for packet in (packet for given in whole.demux(source) if given.size for packet in crop.filter(given)):
            packet.stream = target
            copy.mux(packet)
    video = open_video(tmp_path / "a.mp4")
    for picture, expected in zip(video.read(0, 2), shown, strict=True):
        assert picture.shape == (44, 48, 3)
        assert np.abs(picture.astype(float) - expected[4:, 10:58]).mean() < 3


def test_pictures_before_an_open_gops_keyframe_are_not_counted(tmp_path: Path) -> None:
    """Cut without coding again: the packets of the leading pictures are there, and no decoder shows them."""
    write(
        tmp_path / "whole.mkv",
        "libx265",
        frames=30,
        options={"x265-params": "open-gop=1:keyint=10:min-keyint=1:bframes=3:b-adapt=0:log-level=none"},
    )
    with av.open(str(tmp_path / "whole.mkv")) as whole, av.open(str(tmp_path / "cut.mkv"), "w") as cut:
        source = whole.streams.video[0]
        target = cut.add_stream_from_template(source)
        packets = [packet for packet in whole.demux(source) if packet.size]
        second = [at for at, packet in enumerate(packets) if packet.is_keyframe][1]
        kept = packets[second:]
        leading = sum(packet.pts < kept[0].pts for packet in kept)
        for packet in kept:
            packet.stream = target
            cut.mux(packet)
    assert leading > 0
    source = open_video(tmp_path / "cut.mkv")
    assert source.frame_count == len(kept) - leading
    assert len(list(source.read(0, source.frame_count))) == source.frame_count


@pytest.mark.parametrize("name", ["a.mp4", "odd.mp4"])
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("turns", range(4))
def test_pictures_are_turned_and_mirrored_as_shown(tmp_path: Path, turns: int, flipped: bool, name: str) -> None:
    # Clockwise by 90 degrees: (x, y) is shown at (-y, x).
    matrices = [(1, 0, 0, 1), (0, 1, -1, 0), (-1, 0, 0, -1), (0, -1, 1, 0)]
    a, b, c, d = matrices[turns]
    if flipped:  # left to right, after turning
        a, c = -a, -c
    shown = write(tmp_path / name, frames=2, size=(64, 48))
    (tmp_path / name).write_bytes(with_matrix((tmp_path / name).read_bytes(), a, b, c, d))
    source = open_video(tmp_path / name)
    for expected, picture in zip(shown, source.read(0, 2), strict=True):
        turned = np.rot90(expected, -turns)
        turned = turned[:, ::-1] if flipped else turned
        assert picture.shape == turned.shape == (source.height, source.width, 3)
        assert np.abs(picture.astype(float) - turned).mean() < 3
        assert picture.flags.c_contiguous


def test_an_angle_between_quarter_turns_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.mp4")
    (tmp_path / "a.mp4").write_bytes(with_matrix((tmp_path / "a.mp4").read_bytes(), 1, 1, -1, 1))
    with pytest.raises(RigError, match=r"a\.mp4: is shown at an angle that is no quarter turn"):
        open_video(tmp_path / "a.mp4")


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_largest_track_is_the_cameras(tmp_path: Path, order: tuple[int, int]) -> None:
    pictures = [texture((64, 48)), np.full((24, 32, 3), 90, np.uint8)]
    with av.open(str(tmp_path / "a.mov"), "w") as container:
        streams = []
        for number in order:
            stream = container.add_stream("libx264", rate=25, options=X264)
            stream.height, stream.width = pictures[number].shape[:2]
            stream.pix_fmt = "yuv420p"
            streams.append((stream, pictures[number]))
        for _ in range(3):
            for stream, picture in streams:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        for stream, _ in streams:
            container.mux(stream.encode())
    source = open_video(tmp_path / "a.mov")
    assert (source.width, source.height, source.frame_count) == (64, 48, 3)
    assert np.abs(next(source.read(0, 1)).astype(float) - pictures[0]).mean() < 3


def test_a_cover_is_no_camera(tmp_path: Path) -> None:
    shown = write(tmp_path / "plain.mp4")
    with av.open(str(tmp_path / "plain.mp4")) as plain, av.open(str(tmp_path / "a.mp4"), "w") as container:
        source = plain.streams.video[0]
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 640, 480, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic.value
        target = container.add_stream_from_template(source)
        picture = av.VideoFrame.from_ndarray(np.zeros((480, 640, 3), np.uint8), format="rgb24")
        container.mux(cover.encode(picture.reformat(format="yuvj420p")))
        container.mux(cover.encode())
        for packet in plain.demux(source):
            if packet.size:
                packet.stream = target
                container.mux(packet)
    found = open_video(tmp_path / "a.mp4")
    assert (found.width, found.height, found.frame_count) == (64, 48, len(shown))


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
        expected = f"cam00.mp4 and 2 more: coded as {said}, and taken for sRGB's" if said else ""
        assert len(opened.warnings) == bool(said)
        assert expected in "".join(opened.warnings)
        # FFmpeg 8 takes seconds for the first picture of another gamut: one of them stands for all.
        if primaries == 12:
            assert [picture.shape for _, (picture,) in read_frames(opened, 0, 1, names=["cam00"])]


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


def test_a_title_in_another_encoding_is_passed_over(tmp_path: Path, make: Any) -> None:
    """With PyAV before 19, and after."""
    make.video(tmp_path / "plain.mp4")
    with av.open(str(tmp_path / "plain.mp4")) as plain, av.open(str(tmp_path / "a.mp4"), "w") as container:
        container.metadata["title"] = "TITLE"
        stream = container.add_stream_from_template(plain.streams.video[0])
        for packet in plain.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                container.mux(packet)
    data = (tmp_path / "a.mp4").read_bytes()
    assert b"TITLE" in data
    (tmp_path / "a.mp4").write_bytes(data.replace(b"TITLE", b"caf\xe9\xff"))
    assert open_video(tmp_path / "a.mp4").frame_count == make.frames


def test_a_path_that_is_not_utf8_is_read(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "rig")
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/rig\xff"))
    try:
        rig.rename(odd)
    except OSError:
        pytest.skip("this file system takes names in UTF-8 only")
    assert [len(seen) for _, seen in read_frames(open_rig(odd))] == [3] * make.frames


def test_a_path_in_utf8_is_read_whatever_the_locale(tmp_path: Path, make: Any) -> None:
    rig = make.n3dv(tmp_path / "Bühne")
    plain = {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = "import sys; from decogs.formats.rigs import open_rig; print(open_rig(sys.argv[1]).frame_count)"
    ran = subprocess.run([sys.executable, "-c", code, rig], capture_output=True, text=True, env=os.environ | plain)
    assert (ran.stdout, ran.returncode) == (f"{make.frames}\n", 0), ran.stderr
