"""Videos: every frame in order, far ones by a seek that is checked, and damage found where it is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from decogs.formats import videos
from decogs.formats.errors import RigError
from decogs.formats.videos import VideoSource, open_video

CODEC_TOLERANCE = 4
"""MPEG-4 part 2 at OpenCV's default rate keeps a flat colour within 4 of 255 steps, limited range included."""


class RecordingCapture:
    """A capture that notes what is asked of it."""

    def __init__(self, log: list[str], capture: cv2.VideoCapture) -> None:
        self.log, self.capture = log, capture

    def __getattr__(self, name: str) -> Any:
        return getattr(self.capture, name)

    def grab(self) -> bool:
        self.log.append("grab")
        return self.capture.grab()

    def retrieve(self) -> Any:
        self.log.append("retrieve")
        return self.capture.retrieve()

    def set(self, key: int, value: float) -> bool:
        self.log.append(f"set {key}")
        return self.capture.set(key, value)


@pytest.fixture
def capture_log(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    log: list[str] = []
    make_capture = cv2.VideoCapture
    monkeypatch.setattr(videos.cv2, "VideoCapture", lambda *args: RecordingCapture(log, make_capture(*args)))
    return log


def test_size_count_and_rate_without_decoding(tmp_path: Path, make: Any, capture_log: list[str]) -> None:
    make.video(tmp_path / "a.mp4", frames=7, size=(80, 60), fps=25)
    source = open_video(tmp_path / "a.mp4")
    assert (source.width, source.height, source.frame_count, source.fps) == (80, 60, 7, 25.0)
    np.testing.assert_allclose(source.times, np.arange(7) * 40.0, atol=1e-6)
    # Raw mode is switched on once, and then packets only: 7 of them, and the end.
    assert capture_log == [f"set {cv2.CAP_PROP_FORMAT}"] + ["grab"] * 8


def test_frames_come_in_order_as_rgb(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=6)
    frames = list(open_video(tmp_path / "a.mp4").read(0, 6))
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 6
    for k, frame in enumerate(frames):
        assert frame.dtype == np.uint8
        expected = np.array([40, 30, 20]) + 20 * k
        np.testing.assert_allclose(frame.mean(axis=(0, 1)), expected, atol=CODEC_TOLERANCE)


def test_a_near_start_is_reached_by_passing_over(tmp_path: Path, make: Any, capture_log: list[str]) -> None:
    make.video(tmp_path / "a.mp4", frames=9)
    source = open_video(tmp_path / "a.mp4")
    whole = list(source.read(0, 9))
    capture_log.clear()
    part = list(source.read(5, 7))
    assert capture_log == ["grab"] * 6 + ["retrieve", "grab", "retrieve"]
    np.testing.assert_array_equal(part, whole[5:7])
    capture_log.clear()
    some = list(source.read(2, 7, 3))
    assert capture_log == ["grab"] * 3 + ["retrieve"] + ["grab"] * 3 + ["retrieve", "grab"]
    np.testing.assert_array_equal(some, [whole[2], whole[5]])


def long_video(path: Path, **options: str) -> VideoSource:
    """200 frames of 64x48 that differ, with pictures coded out of order."""
    texture = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(200):
            picture = np.roll(texture, 3 * number, axis=1)
            picture[:8] = number
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return open_video(path)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("closed.mp4", {"g": "25", "bf": "3"}),
        ("open.mp4", {"x264-params": "open-gop=1:keyint=40:bframes=5:b-pyramid=normal:log-level=none"}),
        ("refresh.mp4", {"x264-params": "intra-refresh=1:keyint=30:bframes=0:log-level=none"}),
        ("one.mkv", {"g": "1000", "bf": "2"}),
    ],
)
def test_a_far_start_is_sought(tmp_path: Path, capture_log: list[str], name: str, options: dict[str, str]) -> None:
    source = long_video(tmp_path / name, **options)
    whole = list(source.read(0, 200))
    for start in (64, 99, 120, 161, 199):
        capture_log.clear()
        np.testing.assert_array_equal(list(source.read(start, min(start + 3, 200))), whole[start : start + 3])
        assert capture_log.count("grab") <= 8


@pytest.mark.parametrize("lands", [-15.0, 20.0, 199.0 * 40, float("nan")])
def test_a_seek_that_lands_elsewhere_is_given_up(
    tmp_path: Path, capture_log: list[str], monkeypatch: pytest.MonkeyPatch, lands: float
) -> None:
    source = long_video(tmp_path / "a.mp4")
    whole = list(source.read(0, 125))
    real = VideoSource._frame_at
    monkeypatch.setattr(VideoSource, "_frame_at", lambda self, time: real(self, lands))
    capture_log.clear()
    np.testing.assert_array_equal(list(source.read(120, 123)), whole[120:123])
    assert capture_log.count("grab") == 1 + 123


def test_only_what_is_asked_for_is_decoded(tmp_path: Path, make: Any, capture_log: list[str]) -> None:
    make.video(tmp_path / "a.mp4", frames=9)
    reader = open_video(tmp_path / "a.mp4").read(0, 9)
    capture_log.clear()
    for taken in (1, 2, 3):
        next(reader)
        assert capture_log.count("retrieve") == taken


def test_variable_rate_is_refused_with_the_frame(tmp_path: Path, make: Any) -> None:
    path = tmp_path / "cam03.mp4"
    make.video(path, frames=6, fps=30)
    whole = path.read_bytes()
    usual = int(1e3 * open_video(path).times[1])
    assert usual == 33333
    # OpenCV's mp4 has 512 time units per frame. Equal durations leave the file as it was: the patch itself is sound.
    path.write_bytes(make.with_frame_durations(whole, [512] * 6))
    np.testing.assert_allclose(open_video(path).times, np.arange(6) * 1000 / 30, atol=1e-6)
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
    wrong = VideoSource(source.path, source.width, source.height, 5, source.fps, np.delete(source.times, 3))
    reader = wrong.read(0, 5)
    assert [next(reader).shape for _ in range(3)] == [(48, 64, 3)] * 3
    with pytest.raises(RigError, match=r"a\.mp4: frame 3 is damaged or missing \(decoded 100\.0 ms, expected 133"):
        list(reader)


def test_early_end_names_file_and_frame(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "a.mp4", frames=4)
    source = open_video(tmp_path / "a.mp4")
    longer = VideoSource(source.path, source.width, source.height, 6, source.fps, None)
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


def test_missing_video(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"gone\.mp4: the video is missing"):
        open_video(tmp_path / "gone.mp4")


def test_reordered_frames_of_the_sample_rig() -> None:
    """H.264 with B-frames: packets are not in order of presentation (the box ctts says so), frames are."""
    path = Path(__file__).parents[1] / "demo" / "workbench" / "cam01.mp4"
    assert b"ctts" in path.read_bytes()
    source = open_video(path)
    assert (source.frame_count, source.fps, source.width, source.height) == (9, 30.0, 352, 264)
    np.testing.assert_allclose(source.times, np.arange(9) * 1000 / 30, atol=0.01)
    capture, count = cv2.VideoCapture(str(path)), 0
    for frame in source.read(0, 9):
        np.testing.assert_array_equal(frame, capture.read()[1][:, :, ::-1])
        count += 1
    assert count == 9
