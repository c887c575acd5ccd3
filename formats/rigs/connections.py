"""How the video of a camera that is recording is opened: a file that grows, or the address of a camera that sends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import urlsplit

import av

from ..errors import RigError
from ..files.regular_files import open_regular
from ..videos.reading import ANY_TEXT, DEMUXERS, pictures_of
from .sender_times import StampsOfFile, StampsOfSender

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.stream import VideoStream

_POLL = 0.02
"""Seconds between looks whether a file has grown."""
_PROBED = {"fpsprobesize": "0", "analyzeduration": "1000000"}
"""FFmpeg looks no longer at a video's beginning than it must: what it looks at is held back meanwhile."""
_SILENT = 5.0
"""Seconds without a packet after which a sender is tried anew; three frames of a slow one."""

_RTSP = ("rtsp", "rtsps")
_MPEGTS = ("srt", "udp", "tcp")
SCHEMES = (*_RTSP, *_MPEGTS)
"""Of addresses: RTSP with whatever it sends, the others with MPEG-TS."""
_PROTOCOLS = "rtsp,rtp,tcp,udp,tls,srt"


@dataclass(frozen=True)
class GrowingVideo:
    """A video file that is being written, in a form that can be read from its beginning on."""

    path: Path
    sends: bool = False
    advice: str = "start the camera, and write fragmented mp4, Matroska or MPEG-TS, which can be read as they grow"

    @property
    def origin(self) -> str:
        """The file."""
        return str(self.path)

    @contextmanager
    def opened(self, is_over: Callable[[], bool]) -> Iterator[tuple[InputContainer, VideoStream]]:
        """The video as it grows; it ends where nothing more is there when it ``is_over``."""
        while not self.path.exists():
            if is_over():
                raise FileNotFoundError(0, "it is not there")
            time.sleep(_POLL)
        demuxer = next(name for name, suffixes in DEMUXERS.items() if self.path.suffix.lower() in suffixes)
        with (
            open_regular(self.path) as file,
            av.open(
                _Growing(file, is_over),
                format=demuxer,
                container_options=_PROBED,
                **ANY_TEXT,
            ) as container,
        ):
            yield container, pictures_of(self.path, container)

    def stamps(self) -> StampsOfFile:
        """The first picture is frame 0."""
        return StampsOfFile()


class _Growing:
    """A file whose end is waited at until it is over."""

    def __init__(self, file: BinaryIO, is_over: Callable[[], bool]) -> None:
        self._file, self._is_over = file, is_over

    def read(self, size: int) -> bytes:
        """What is there, at least a byte; none at the end."""
        while True:
            over = self._is_over()
            if (data := self._file.read(size)) or over:
                return data
            time.sleep(_POLL)


@dataclass(frozen=True)
class SendingCamera:
    """The address of a camera that sends, at the rate of the recording."""

    address: str
    fps: float
    sends: bool = True
    advice: str = "start the camera, and check its address"

    @property
    def origin(self) -> str:
        """The address without user and password."""
        parts = urlsplit(self.address)
        return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()

    @contextmanager
    def opened(self, is_over: Callable[[], bool]) -> Iterator[tuple[InputContainer, VideoStream]]:
        """What the camera sends, while it does."""
        scheme = urlsplit(self.address).scheme
        options: dict[str, str] = _PROBED | {"protocol_whitelist": _PROTOCOLS}
        more: dict[str, Any] = {"format": "mpegts"}
        if scheme in _RTSP:
            # One connection brings pictures and reports in their order; a lost datagram would damage pictures.
            options, more = options | {"rtsp_transport": "tcp"}, {}
        with av.open(
            self.address, container_options=options, timeout=max(_SILENT, 3 / self.fps), **more, **ANY_TEXT
        ) as container:
            yield container, pictures_of(Path(self.origin), container)

    def stamps(self) -> StampsOfSender:
        """By RTCP reports of the sender's clock, else by arrival."""
        return StampsOfSender(self.fps, reports=urlsplit(self.address).scheme in _RTSP)


def check_address(address: str, where: str) -> None:
    """Raises RigError for an address that nothing is read from here; ``where`` says which file has it."""
    scheme = address.partition(":")[0]
    if scheme not in SCHEMES:
        raise RigError(
            f"{where}: {scheme}:// is not read; give an address of {', '.join(SCHEMES)}, a file or a pattern"
        )
    try:
        parts = urlsplit(address)
        is_whole = bool(parts.hostname) and (parts.port is not None or scheme in _RTSP)
    except ValueError:
        is_whole = False
    if not is_whole:
        raise RigError(f"{where}: the address has no host, or no port; write it as {scheme}://HOST:PORT")
    if scheme == "srt" and not _has_srt():
        raise RigError(
            f"{where}: this FFmpeg (of PyAV) was built without SRT; pass the camera on by udp, "
            "ffmpeg -i srt://CAMERA -c copy -f mpegts udp://127.0.0.1:PORT, and give udp://127.0.0.1:PORT"
        )


def _has_srt() -> bool:
    """Whether PyAV's FFmpeg knows the protocol; nothing is connected to."""
    try:
        av.open("srt://", timeout=0.1).close()
    except av.ProtocolNotFoundError:
        return False
    except (av.FFmpegError, OSError):
        pass
    return True
