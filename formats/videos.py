"""Reads a video in sequence, one frame at a time; a seek is only trusted if the time of what it finds is a frame's.

Opening walks the container's packets without decoding them (OpenCV's raw mode). That is cheap in every container, sees
a file that was cut off, and gives the frame count and every presentation time: a variable frame rate is found before
training starts, and a frame the decoder drops silently is found when it is read.
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from .errors import RigError
from .pictures import MAX_PIXELS, Picture
from .quiet import quiet_opencv
from .video_tags import read_tags

VIDEO_SUFFIXES = frozenset({".mp4", ".m4v", ".mov", ".mkv", ".avi", ".webm"})

_FILES_PER_VIDEO = 2
"""Open at the same time while one is opened."""

_PASSED_OVER = 64
"""First frames to read below which the ones before are decoded and passed over: a seek decodes tens of frames, too."""
_SAME_TIME = 0.25
"""Share of a frame's duration within which a time is that frame's."""

_BOXED_SUFFIXES = frozenset({".mp4", ".m4v", ".mov"})
_FIRST_BOXES = frozenset({b"ftyp", b"styp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot"})

_RATE_TOLERANCE = 0.5
"""A frame may last this share longer or shorter than usual: rounded time stamps (1 ms in Matroska) pass, a dropped or
doubled frame does not."""


@dataclass(frozen=True)
class VideoSource:
    """The frames of one camera in a video file.

    Width and height in pixels; fps None if the file does not say. ``times``: presentation time of every frame in
    milliseconds, (frame_count,), or None if the container has no usable times. ``warnings``: see
    ``FrameSource``.
    """

    path: Path
    width: int
    height: int
    frame_count: int
    fps: float | None
    times: NDArray[np.float64] | None = field(default=None, repr=False, compare=False)
    warnings: tuple[str, ...] = ()

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """Every step-th frame from start (inclusive) to stop (exclusive), RGB uint8; others are passed over.

        A far start is sought, unless that does not find a frame before it. Raises RigError if the video ends early,
        drops a frame, or changes its size.
        """
        capture, first = self._capture_near(start)
        try:
            for index in range(first, stop):
                with quiet_opencv():
                    grabbed = capture.grab()
                if not grabbed:
                    raise RigError(
                        f"{self.path}: the video ends or is damaged at frame {index} although it announces "
                        f"{self.frame_count} frames; re-encode it, or stop before frame {index}"
                    )
                self._check_time(index, capture.get(cv2.CAP_PROP_POS_MSEC))
                if index >= start and (index - start) % step == 0:
                    yield self._retrieve(capture, index)
        finally:
            capture.release()

    def _capture_near(self, start: int) -> tuple[cv2.VideoCapture, int]:
        """A capture at a frame at or before ``start``, and that frame."""
        capture = _capture(self.path)
        if start < _PASSED_OVER or self.times is None:
            return capture, 0
        with quiet_opencv():
            sought = capture.set(cv2.CAP_PROP_POS_FRAMES, start - 1) and capture.grab()
        found = self._frame_at(capture.get(cv2.CAP_PROP_POS_MSEC)) if sought else None
        if found is not None and found < start:
            return capture, found + 1
        capture.release()
        return _capture(self.path), 0

    def _frame_at(self, time: float) -> int | None:
        """The frame that is shown at a time in milliseconds; None if there is none."""
        if self.times is None or not np.isfinite(time):
            return None
        usual = (self.times[-1] - self.times[0]) / (self.frame_count - 1)
        nearest = int(np.abs(self.times - time).argmin())
        return nearest if abs(self.times[nearest] - time) <= _SAME_TIME * usual else None

    def _check_time(self, index: int, time: float) -> None:
        if self.times is None or self.frame_count < 2:
            return
        usual = (self.times[-1] - self.times[0]) / (self.frame_count - 1)
        if abs(time - self.times[index]) > _RATE_TOLERANCE * usual:
            raise RigError(
                f"{self.path}: frame {index} is damaged or missing (decoded {time:.1f} ms, "
                f"expected {self.times[index]:.1f} ms); re-encode the video"
            )

    def _retrieve(self, capture: cv2.VideoCapture, index: int) -> NDArray[np.uint8]:
        try:
            with quiet_opencv():
                ok, bgr = capture.retrieve()
        except cv2.error:
            ok = False
        if not ok or bgr.dtype != np.uint8 or bgr.ndim != 3 or bgr.shape[2] != 3:
            raise RigError(f"{self.path}: frame {index} cannot be decoded; re-encode the video")
        if bgr.shape != (self.height, self.width, 3):
            raise RigError(
                f"{self.path}: frame {index} is {bgr.shape[1]} x {bgr.shape[0]} pixels, the video started with "
                f"{self.width} x {self.height}; re-encode it to one size"
            )
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), np.uint8)


def open_video(path: Path) -> VideoSource:
    """Size, frame count and rate of a video; no frame is decoded, unless an edit list hides some.

    Raises RigError if the file is missing, is no video, has no frames or a variable frame rate.
    """
    if not path.is_file():
        raise RigError(f"{path}: the video is missing; put it back or take its camera out of the calibration")
    _check_whole(path)
    capture = _capture(path)
    try:
        width = int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        stated_fps = capture.get(cv2.CAP_PROP_FPS)
        stamps = _packet_times(path, capture)
    finally:
        capture.release()
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise RigError(f"{path}: frames of {width} x {height} pixels cannot be read; re-encode the video")
    if stamps.size == 0:
        raise RigError(f"{path}: the video holds no frames; record or export it again")
    tags = read_tags(path)
    if tags.shown is not None and _hides(tags.shown, stamps):
        stamps = _shown_times(path)
    times = stamps if stamps.size == 1 or np.diff(stamps).min() > 0 else None
    if times is not None:
        _check_constant_rate(path, times)
    return VideoSource(path, width, height, int(stamps.size), _rate(stated_fps, times), times, _warnings(tags.colours))


def _warnings(coding: str) -> tuple[str, ...]:
    if not coding:
        return ()
    return (
        f"its colours are tagged {coding}, and FFmpeg, by its version, takes them for sRGB's or converts them its own "
        "way; convert the videos to BT.709 for right ones",
    )


def _check_whole(path: Path) -> None:
    """The top-level boxes of an mp4 or mov file end where the file ends. Source: ISO 14496-12, section 4.2."""
    if path.suffix.lower() not in _BOXED_SUFFIXES:
        return
    try:
        with path.open("rb") as file:
            end, at = path.stat().st_size, 0
            while at <= end - 8:
                file.seek(at)
                size, kind, long_size = struct.unpack(">I4sQ", file.read(16).ljust(16, b"\0"))
                size = end - at if size == 0 else long_size if size == 1 else size
                if size < 8 or (at == 0 and kind not in _FIRST_BOXES):
                    return  # not made of boxes: the decoder decides
                if size > end - at:
                    raise RigError(f"{path}: the video file is truncated; copy it again from its source")
                at += size
    except OSError as error:
        raise _not_opened(path, error) from None


def _capture(path: Path) -> cv2.VideoCapture:
    # FFmpeg is named, and the path is absolute: otherwise "cam%02d" would be a sequence and "http:" an address.
    # One decoding thread each: a rig has tens of videos, which are read side by side, and every further thread would
    # hold another frame.
    name = _utf8_name(path.absolute())
    try:
        with quiet_opencv():
            capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
            opened = capture.isOpened()
    except cv2.error:
        opened = False
    if not opened:
        _check_can_open(path)
        raise RigError(f"{path}: the file is no video that can be read, or is damaged; re-encode it (H.264 in mp4)")
    return capture


def _utf8_name(path: Path) -> str:
    """The path as OpenCV takes it: in UTF-8, whatever the locale. It crashes on bytes that are not."""
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeDecodeError:
        raise RigError(f"{path}: its path is not UTF-8, so no video in it can be opened; rename it") from None


def _check_can_open(path: Path) -> None:
    """Says why a file cannot even be opened, which OpenCV does not report."""
    try:
        for file in [path.open("rb") for _ in range(_FILES_PER_VIDEO)]:
            file.close()
    except OSError as error:
        raise _not_opened(path, error) from None


def _not_opened(path: Path, error: OSError) -> RigError:
    remedy = "allow more, by ulimit -n" if error.errno == errno.EMFILE else "fix its rights"
    return RigError(f"{path}: cannot be read ({error.strerror}); {remedy}")


def _packet_times(path: Path, capture: cv2.VideoCapture) -> NDArray[np.float64]:
    """Presentation times of all packets in milliseconds, sorted (packets come in decoding order)."""
    if not capture.set(cv2.CAP_PROP_FORMAT, -1):
        raise RigError(f"{path}: the packets of this video cannot be listed; re-encode it (H.264 in mp4)")
    stamps = []
    with quiet_opencv():
        while capture.grab():
            stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return np.sort(np.asarray(stamps, np.float64))


def _hides(shown: float, stamps: NDArray[np.float64]) -> bool:
    """Whether an edit list that shows so many seconds leaves out some of the frames with these times (ms)."""
    return stamps.size > 1 and shown * 1000 < (stamps.size - 0.5) * float(np.median(np.diff(stamps)))


def _shown_times(path: Path) -> NDArray[np.float64]:
    """Presentation times in milliseconds of the frames that the decoder hands out; it alone knows which are cut off."""
    capture = _capture(path)
    try:
        stamps = []
        while capture.grab():
            stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    finally:
        capture.release()
    return np.asarray(stamps, np.float64)


def _check_constant_rate(path: Path, times: NDArray[np.float64]) -> None:
    if times.size < 3:
        return
    lasting = np.diff(times)
    usual = float(np.median(lasting))
    odd = np.flatnonzero(np.abs(lasting - usual) > _RATE_TOLERANCE * usual)
    if odd.size:
        raise RigError(
            f"{path}: variable frame rate or missing frames (frame {odd[0]} lasts {lasting[odd[0]]:.1f} ms, most "
            f"last {usual:.1f} ms); convert all videos of the rig to one constant rate, e.g. with ffmpeg -fps_mode cfr"
        )


def _rate(stated: float, times: NDArray[np.float64] | None) -> float | None:
    """Frames per second: as stated, unless the times contradict."""
    stated_is_usable = bool(np.isfinite(stated)) and 0 < stated < 10_000
    if times is None or times.size < 2:
        return float(stated) if stated_is_usable else None
    measured = float(1000 * (times.size - 1) / (times[-1] - times[0]))
    return float(stated) if stated_is_usable and abs(stated - measured) <= 0.05 * measured else measured
