"""A camera on the network, for tests: H.264 by RTSP on the loopback, RTP in the same connection, reports of its clock.

Source: RFC 2326 (RTSP), section 10.12 for RTP inside it; RFC 3550, section 6.4.1 (sender reports); RFC 6184 (H.264).
"""

from __future__ import annotations

import base64
import re
import socket
import struct
import threading
import time
from collections.abc import Collection, Iterable
from contextlib import suppress
from fractions import Fraction

import av
import numpy as np

_1900 = 2208988800
"""Seconds from 1900, where NTP begins to count, to 1970."""
_LARGEST = 1200
"""Bytes of a unit that goes into one packet."""


def coded(pictures: Iterable[np.ndarray], fps: int) -> list[list[bytes]]:
    """Of each picture (H, W, 3) the units of H.264, every picture decodable by itself."""
    encoder = av.CodecContext.create("libx264", "w")
    frames = []
    for picture in pictures:
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p")
        if not encoder.is_open:
            encoder.width, encoder.height, encoder.pix_fmt = frame.width, frame.height, "yuv420p"
            encoder.framerate, encoder.time_base = fps, Fraction(1, fps)
            encoder.options = {
                "tune": "zerolatency",
                "qp": "4",
                "g": "1",
                "x264-params": "repeat-headers=1:threads=1",
            }
        frame.pict_type = 1
        (packet,) = encoder.encode(frame)
        frames.append([unit for unit in re.split(rb"\x00\x00\x00?\x01", bytes(packet)) if unit])
    return frames


class RtspCamera:
    """Takes picture m of ``frames`` at ``begin + m / fps`` and sends it ``latency`` seconds later; a context manager.

    ``clock``: seconds by which its clock is fast; None sends no reports. ``lost``: pictures that are not sent.
    ``cut``: pictures before which its connections break.
    """

    def __init__(
        self,
        frames: list[list[bytes]],
        fps: float,
        begin: float,
        *,
        latency: float = 0.0,
        clock: float | None = 0.0,
        lost: Collection[int] = (),
        cut: Collection[int] = (),
    ) -> None:
        self._frames, self._fps, self._begin, self._latency = frames, fps, begin, latency
        self._clock, self._lost, self._cut = clock, lost, cut
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://user:secret@127.0.0.1:{self._server.getsockname()[1]}/live"
        self.connections = 0
        threading.Thread(target=self._serve, daemon=True).start()

    def __enter__(self) -> RtspCamera:
        return self

    def __exit__(self, *error: object) -> None:
        self._server.close()

    def _serve(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._server.accept()
                self.connections += 1
                threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        with suppress(OSError), connection, connection.makefile("rb") as requests:
            while line := requests.readline():
                headers = {}
                while (header := requests.readline().strip()) != b"":
                    name, _, value = header.decode().partition(":")
                    headers[name.lower()] = value.strip()
                method, body, more = line.split()[0].decode(), "", "Session: 1\r\n"
                if method == "DESCRIBE":
                    body, more = self._description(), "Content-Type: application/sdp\r\n"
                elif method == "SETUP":
                    more += "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n"
                elif method == "OPTIONS":
                    more = "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n"
                length = f"Content-Length: {len(body)}\r\n\r\n"
                connection.sendall(f"RTSP/1.0 200 OK\r\nCSeq: {headers['cseq']}\r\n{more}{length}{body}".encode())
                if method == "PLAY":
                    self._send(connection)
                    return

    def _description(self) -> str:
        sets = [unit for unit in self._frames[0] if unit[0] & 31 in (7, 8)]
        sets64 = ",".join(base64.b64encode(unit).decode() for unit in sets)
        return (
            "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=-\r\nc=IN IP4 127.0.0.1\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
            f"a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1;sprop-parameter-sets={sets64}\r\n"
            "a=control:track\r\n"
        )

    def _send(self, connection: socket.socket) -> None:
        """The pictures from now on."""
        now = (time.time() - self._begin - self._latency) * self._fps
        sequence, origin = 0, 12345 + self.connections * 1_000_000
        for number in range(max(0, int(np.ceil(now))), len(self._frames)):
            taken = self._begin + number / self._fps
            time.sleep(max(0.0, taken + self._latency - time.time()))
            if number in self._cut:
                return
            stamp = (origin + round((taken - self._begin) * 90000)) & 0xFFFFFFFF
            if self._clock is not None:
                _interleave(connection, 1, _report(taken + self._clock, stamp))
            if number in self._lost:
                continue
            for unit, is_last in _packets(self._frames[number]):
                header = struct.pack(">BBHII", 0x80, 96 | is_last << 7, sequence & 0xFFFF, stamp, 1)
                _interleave(connection, 0, header + unit)
                sequence += 1
        time.sleep(30)  # silent, and there


def _interleave(connection: socket.socket, channel: int, data: bytes) -> None:
    connection.sendall(struct.pack(">cBH", b"$", channel, len(data)) + data)


def _report(at: float, stamp: int) -> bytes:
    """What time it is on the sender's clock, seconds since 1970, at a stamp."""
    return struct.pack(">BBHIQIII", 0x80, 200, 6, 1, int((at + _1900) * 2**32), stamp, 0, 0)


def _packets(units: list[bytes]) -> Iterable[tuple[bytes, bool]]:
    """The payloads of a picture's packets, and whether each is its last."""
    for place, unit in enumerate(units):
        is_last = place == len(units) - 1
        if len(unit) <= _LARGEST:
            yield unit, is_last
            continue
        parts = [unit[at : at + _LARGEST] for at in range(1, len(unit), _LARGEST)]
        for number, part in enumerate(parts):
            ends = number == len(parts) - 1
            yield bytes([unit[0] & 0xE0 | 28, (number == 0) << 7 | ends << 6 | unit[0] & 31]) + part, is_last and ends
