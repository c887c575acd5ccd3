"""A camera's video while it is recorded: a file that grows, or a camera that sends it.

A thread takes packets, as they are coded, and whoever asks for a frame decodes up to it. Of a file, the thread waits
while its queue is full; of a sender, the oldest packets go, up to one that decoding can begin with. A connection that
breaks is made anew.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import av

from ..cameras import Camera
from ..errors import RigError
from ..pictures.reading import Picture
from ..videos.reading import VideoSource, presentation_of
from .feeds import DAMAGED, LACKING, OVERRUN, of_another_size
from .sender_times import CaptureTime, SharedClock

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.codeccontext import VideoCodecContext
    from av.video.stream import VideoStream

_MAX_QUEUE = 64 << 20
"""Bytes of packets of one camera: ten seconds of 50 Mbit/s."""
_PAUSES = (0.2, 1.0, 5.0)
"""Seconds before a connection is tried again, the last for all that follow."""
_REMEMBERED = 1000
"""Damaged frames whose reason is known when they are asked for."""


class Connection(Protocol):
    """How a camera's video is opened, and what its time stamps mean."""

    @property
    def origin(self) -> str:
        """The file or address, without a password."""
        ...

    @property
    def advice(self) -> str:
        """What to do where nothing comes."""
        ...

    @property
    def sends(self) -> bool:
        """Whether what is not taken is lost, and a connection that ended is made anew."""
        ...

    def opened(self, is_over: Callable[[], bool]) -> AbstractContextManager[tuple[InputContainer, VideoStream]]:
        """The video, as far as it comes. Raises OSError, RigError or av.FFmpegError where there is none."""
        ...

    def stamps(self) -> Stamps:
        """Of the connection that was opened last."""
        ...


class Stamps(Protocol):
    """Time stamps of one connection."""

    def locate(self, stamp: float, sent: float | None, now: float) -> CaptureTime | None:
        """Where a picture is; None while that is not known, as it is for all before, once it is."""
        ...


@dataclass(frozen=True)
class _Coded:
    """A packet: its bytes, where its picture is, whether decoding can begin with it, and by what it is decoded."""

    data: bytes
    capture: CaptureTime
    is_key: bool
    context: VideoCodecContext


class VideoFeed:
    """The frames of one camera's video as they come (`feeds.Feed`)."""

    def __init__(self, camera: Camera, connection: Connection, clock: SharedClock, fps: float, most: int) -> None:
        """``most``: packets that wait for being decoded."""
        self._camera, self._connection, self._clock, self._fps, self._most = camera, connection, clock, fps, most
        self._lock = threading.Condition()
        self._queue: deque[_Coded] = deque()
        self._bytes = 0
        self._newest: CaptureTime | None = None
        self._thrown: CaptureTime | None = None
        self._needs_key = False  # of the queue's next packet
        self._over = threading.Event()
        self._drained = False
        self._error = ""
        self._context: VideoCodecContext | None = None
        self._begun = False  # whether the context has had a packet that decoding can begin with
        self._shown: VideoSource | None = None
        self._decoded: deque[tuple[int, VideoFrame]] = deque()
        self._damaged: deque[int] = deque(maxlen=_REMEMBERED)
        if connection.sends:
            clock.expect(camera.name)
        self._thread = threading.Thread(target=self._take_all, name=f"decogs-{camera.name}", daemon=True)
        self._thread.start()

    @property
    def origin(self) -> str:
        """The file or address, and why it was not to be read."""
        return self._connection.origin + (f" ({self._error})" if self._error else "")

    @property
    def advice(self) -> str:
        """What to do where no picture comes at all."""
        return self._connection.advice

    def reached(self, frame: int) -> bool:
        """Whether this frame has come, or one after it, decoded or not."""
        newest, zero = self._newest, self._zero
        return newest is not None and zero is not None and newest.frame(zero, self._fps) >= frame

    def take(self, frame: int) -> Picture | None:
        """The picture of a frame; None while it is not there. Raises RigError for what cannot be encoded."""
        while not self._decoded or self._decoded[0][0] < frame:
            if self._decoded:
                self._decoded.popleft()
            elif not self._decode():
                return None
        number, decoded = self._decoded[0]
        if number > frame:
            return None
        if self._shown is None:
            self._shown = presentation_of(Path(self._connection.origin), decoded)
            if (self._shown.width, self._shown.height) != (self._camera.width, self._camera.height):
                raise of_another_size(self._connection.origin, self._camera, self._shown.width, self._shown.height)
        return self._shown.picture(decoded, frame)

    def holds(self, frame: int) -> bool:
        """Whether the frame's packet has come, which the decoder gives out after those of others."""
        return self.reached(frame) and not self.is_over(frame) and not self._drained

    def is_over(self, frame: int) -> bool:
        """Whether a later frame is decoded, or this one is known to be damaged."""
        return (bool(self._decoded) and self._decoded[0][0] > frame) or frame in self._damaged

    def why(self, frame: int) -> str:
        """Damaged, thrown away, or never come."""
        if frame in self._damaged:
            return DAMAGED
        zero, thrown = self._zero, self._thrown
        if thrown is not None and zero is not None and thrown.frame(zero, self._fps) >= frame:
            return OVERRUN
        return LACKING

    def finish(self) -> bool:
        """Gives out what demuxer and decoder hold back; whether there may be anything still."""
        self._over.set()
        with self._lock:
            self._lock.notify_all()
        if self._drained:
            return False
        no_more = self._connection.sends or not self._thread.is_alive()
        if no_more and (not self._queue or self._zero is None):
            self._drained = True
            self._flush()
        return True

    def close(self) -> None:
        """Ends the thread, which may be waiting for a sender for some seconds more."""
        self._over.set()
        with self._lock:
            self._lock.notify_all()
        if not self._connection.sends:
            self._thread.join()

    @property
    def _zero(self) -> float | None:
        return self._clock.zero if self._connection.sends else 0.0

    def _take_all(self) -> None:
        tries = 0
        while not self._over.is_set():
            try:
                with self._connection.opened(self._over.is_set) as (container, stream):
                    for coded in self._packets(container, stream):
                        self._put(coded)
                        tries, self._error = 0, ""
                        if self._over.is_set() and self._connection.sends:
                            return
                self._error = "it ended"
            except (av.FFmpegError, OSError, RigError) as error:
                self._error = str(getattr(error, "strerror", None) or error)
            if not self._connection.sends:
                return
            self._over.wait(_PAUSES[min(tries, len(_PAUSES) - 1)])
            tries += 1

    def _packets(self, container: InputContainer, stream: VideoStream) -> Iterator[_Coded]:
        """Those of one connection, from the moment on from which it is known when they were taken."""
        stamps, held, unit = self._connection.stamps(), deque[tuple[float, bytes, bool]](), float(stream.time_base or 0)
        started, begun = time.time(), False
        for packet in container.demux(stream):
            begun = begun or packet.is_keyframe
            if not packet.size or not begun:
                continue
            now = time.time()
            time_stamp = packet.pts if packet.pts is not None else packet.dts
            stamp = now - started if time_stamp is None else time_stamp * unit
            sent = _sent(packet)
            held.append((stamp, bytes(packet), packet.is_keyframe))
            capture = stamps.locate(stamp, sent, now)
            while capture is not None and held:
                earlier, data, is_key = held.popleft()
                at = CaptureTime(capture.since, capture.at - (stamp - earlier))
                self._clock.begin(self._camera.name, at.at)
                yield _Coded(data, at, is_key, stream.codec_context)

    def _put(self, coded: _Coded) -> None:
        with self._lock:
            if not self._connection.sends:
                while self._is_full() and not self._over.is_set():
                    self._lock.wait()
            elif self._is_full():
                self._throw_away()
            self._queue.append(coded)
            self._bytes += len(coded.data)
            if self._newest is None or coded.capture.at > self._newest.at:
                self._newest = coded.capture

    def _is_full(self) -> bool:
        return len(self._queue) >= self._most or self._bytes >= _MAX_QUEUE

    def _throw_away(self) -> None:
        """The oldest packets, up to one that decoding can begin with."""
        while self._queue:
            self._thrown = self._queue[0].capture
            self._bytes -= len(self._queue.popleft().data)
            if self._queue and self._queue[0].is_key:
                break
        self._needs_key = True

    def _decode(self) -> bool:
        """Decodes the next packet; whether there was one."""
        if self._zero is None:
            return False
        with self._lock:
            if not self._queue:
                return False
            coded = self._queue.popleft()
            self._bytes -= len(coded.data)
            broken, self._needs_key = self._needs_key, False
            self._lock.notify_all()
        if coded.context is not self._context:
            self._flush()
            self._context, self._begun, self._shown = coded.context, False, None
        elif broken:
            self._context.flush_buffers()
            self._begun = False
        self._begun = self._begun or coded.is_key
        number = coded.capture.frame(self._zero, self._fps)
        if self._begun:
            packet = av.Packet(coded.data)
            packet.pts = packet.dts = number
            try:
                self._add(self._context.decode(packet))
            except av.FFmpegError:
                self._damage(number)
        elif number - 1 in self._damaged:
            self._damaged.append(number)  # it builds on what is damaged, as all do up to a keyframe
        else:
            self._thrown = coded.capture
        return True

    def _flush(self) -> None:
        if self._context is not None:
            with suppress(av.FFmpegError):
                self._add(self._context.decode(None))

    def _add(self, frames: list[VideoFrame]) -> None:
        for frame in frames:
            if frame.pts is not None and not frame.is_corrupt:
                self._decoded.append((frame.pts, frame))
            elif frame.pts is not None:
                self._damage(frame.pts)

    def _damage(self, number: int) -> None:
        """A frame cannot be decoded: nothing is, before decoding can begin anew."""
        assert self._context is not None
        self._damaged.append(number)
        self._context.flush_buffers()
        self._begun = False


def _sent(packet: av.Packet) -> float | None:
    """When a packet's picture was taken on its sender's clock, seconds since 1970, where that is told.

    Source: FFmpeg, libavutil AVProducerReferenceTime, which its RTP reader fills in from RTCP sender reports.
    """
    if not packet.has_sidedata("prft"):
        return None
    return int.from_bytes(bytes(packet.get_sidedata("prft"))[:8], "little", signed=True) / 1e6
