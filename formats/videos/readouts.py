"""How long a camera takes to read its rows, which GoPros write beside their videos.

Source: GPMF, the telemetry of GoPros (github.com/gopro/gpmf-parser): a track of nested keys, of which ``SROT`` is the
sensor's readout in milliseconds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import av
from av.container import InputContainer

MAX_READOUT = 0.2
"""Seconds: sensors take up to a thirtieth, or the slowest ones a tenth."""
_DEVICE, _READOUT = b"DEVC", b"SROT"
"""What telemetry begins with, and what is looked for in it."""
_MAX_BYTES = 1 << 20
"""Of one second's telemetry: ten times what cameras write."""


def stated_readout(container: InputContainer) -> float:
    """Seconds from the exposure of the sensor's first row to that of its last, 0 where the video states none.

    The container is read from its beginning.
    """
    for track in container.streams.data:
        try:
            container.seek(0)
            data = next((bytes(packet) for packet in container.demux(track) if packet.size), b"")
        except av.FFmpegError:
            continue
        if data.startswith(_DEVICE):
            seconds = next(_readouts(data[:_MAX_BYTES]), 0.0) / 1000
            return seconds if 0 < seconds <= MAX_READOUT else 0.0
    return 0.0


def _readouts(data: bytes) -> Iterator[float]:
    """Every readout in a packet of telemetry; a key of type 0 holds others."""
    at = 0
    while at + 8 <= len(data):
        key, kind, size, count = struct.unpack_from(">4scBH", data, at)
        at += 8
        if key == _READOUT and (kind, size) == (b"f", 4) and count and at + 4 <= len(data):
            yield struct.unpack_from(">f", data, at)[0]
        if kind != b"\0":
            at += -(-size * count // 4) * 4
