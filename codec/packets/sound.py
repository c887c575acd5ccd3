"""Sound beside the frames: the header's list of tracks, and the SOUND packets that hold them (SPEC.md, "Sound").

Nothing of it is needed for the pictures. A list that is out of its bounds counts as absent, so that a reader which
knows no sound makes the same of any stream.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import Packet
from decogs.formats.stream.reasons import Reason

from ..scene.lattice import Vector

RATE = 48_000
"""Samples a second of every track, and the unit of all times here."""
BLOCK = 960
"""Samples of a coded block: 20 ms."""
PRE_ROLL = 10 * BLOCK
"""Samples before a place from which a decoder is run to be right there: what it does not know of the past halves with
every block (RFC 6716, section 4.3.2.1), so that a thousandth is left."""
CONTINUES = 48
"""Samples by which a packet may miss the end of the one before and still go on with it: rounding of frames' starts."""
MAX_TRACKS = 16
MAX_CHANNELS = 2
MAX_BLOCK_BYTES = 1276
"""The largest Opus packet of one 20 ms frame. Source: RFC 6716, section 3.2.1, and its first byte."""
MAX_BLOCKS = 1024
"""In a packet: 20 s, where a frame is heard for one at most."""
MAX_PACKETS = 64
"""Of a frame."""
SLOWEST = 1.0
"""Frames per second below which a stream has no sound, so that a frame's is at most a second."""

_CODEC = "opus"
_MAX_TITLE = 1 << 16
_COORDINATE_MAX = 1e12
_OFFSET = struct.Struct("<i")
_LENGTH = struct.Struct("<H")


@dataclass(frozen=True)
class SoundTrack:
    """One track: ``channels`` 1 or 2; ``title``: what it is, in words; ``position``: where it comes from in the scene.

    The position is where things are stored, before the stream's transform; None for sound that has no place.
    """

    channels: int = 2
    title: str = ""
    position: Vector | None = None

    def as_document(self) -> dict[str, Any]:
        """The header's entry."""
        title = {"title": self.title} if self.title else {}
        position = {} if self.position is None else {"position": [float(value) for value in self.position]}
        return {"codec": _CODEC, "channels": self.channels, **title, **position}


@dataclass(frozen=True)
class SoundPacket:
    """Coded ``blocks`` of a ``track``, without a gap; the first begins ``offset`` samples after its frame."""

    track: int
    offset: int
    blocks: tuple[bytes, ...]

    def payload(self) -> bytes:
        """As it lies in the packet."""
        parts = [bytes([self.track]), _OFFSET.pack(self.offset)]
        for block in self.blocks:
            parts += [_LENGTH.pack(len(block)), block]
        return b"".join(parts)


def read_sound_tracks(document: object, fps: float | None) -> tuple[SoundTrack, ...]:
    """The tracks in a header's member ``sound``; none where it, or any entry, is out of bounds."""
    if not isinstance(document, list) or len(document) > MAX_TRACKS or fps is None or fps < SLOWEST:
        return ()
    tracks = [_track(entry) for entry in document]
    return tuple(track for track in tracks if track is not None) if None not in tracks else ()


def read_sound(packet: Packet, tracks: Sequence[SoundTrack]) -> SoundPacket:
    """What a SOUND packet holds of one of these ``tracks``. Raises StreamError "bad-payload"."""
    try:
        return _read_sound(packet, tracks)
    except StreamError as error:
        error.sound_of = packet.frame
        raise


def _read_sound(packet: Packet, tracks: Sequence[SoundTrack]) -> SoundPacket:
    cursor = packet.cursor()
    track = cursor.u8()
    if track >= len(tracks):
        cursor.fail(Reason.BAD_PAYLOAD, f"sound of track {track}, and the header has {len(tracks)}")
    (offset,) = _OFFSET.unpack(cursor.take(_OFFSET.size))
    blocks: list[bytes] = []
    while cursor.remaining or not blocks:
        (length,) = _LENGTH.unpack(cursor.take(_LENGTH.size))
        if not 0 < length <= MAX_BLOCK_BYTES:
            cursor.fail(Reason.BAD_PAYLOAD, f"a block of sound has 1 to {MAX_BLOCK_BYTES} bytes, not {length}")
        if len(blocks) == MAX_BLOCKS:
            cursor.fail(Reason.BAD_PAYLOAD, f"more than {MAX_BLOCKS} blocks of sound")
        blocks.append(bytes(cursor.take(length)))
    return SoundPacket(track, offset, tuple(blocks))


def frame_start(frame: int, fps: float) -> int:
    """The sample with which a frame begins."""
    return math.floor(frame * RATE / fps + 0.5)


def _track(entry: object) -> SoundTrack | None:
    if not isinstance(entry, Mapping):
        return None
    channels, title, position = entry.get("channels"), entry.get("title", ""), entry.get("position")
    if entry.get("codec") != _CODEC or type(channels) is not int or not 1 <= channels <= MAX_CHANNELS:
        return None
    if not isinstance(title, str) or len(title) > _MAX_TITLE:
        return None
    if "position" not in entry:
        return SoundTrack(channels, title)
    if not isinstance(position, list) or len(position) != 3:
        return None
    if not all(type(value) in (int, float) and abs(value) <= _COORDINATE_MAX for value in position):
        return None
    x, y, z = map(float, position)
    return SoundTrack(channels, title, (x, y, z))
