"""Sections 1 to 3 of the plain decoder: limits, reasons, fields, and the packets of a container."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NoReturn

SIGNATURE = bytes.fromhex("8b4447530d0a1a0a")
TEXT_DAMAGE = tuple(map(bytes.fromhex, ("8b4447530a1a0a", "8b4447530d0d0a1a0d0a", "0b4447530d0a1a0a")))
SYNC = b"DGSP"
HEADER, KEY, DELTA, SKIP, INDEX, END, METRICS, SOUND, REFINE, LAYERS = range(1, 11)
FRAME_KINDS = (KEY, DELTA, SKIP)
CRITICAL = {HEADER: 1, KEY: 1, DELTA: 1, SKIP: 1, INDEX: 0, END: 0, METRICS: 0, SOUND: 0}
MEANS, LOG_SCALES, QUATERNIONS, OPACITY_LOGITS, SH_DC, SH_REST = range(6)
VALUES, RESIDUALS = "values", "residuals"
CORRECTIONS = {
    "exposure_drift": ["exposure"],
    "white_balance_drift": ["red", "blue"],
    "camera_shake": ["yaw", "pitch", "roll"],
    "lamp_flicker": ["lamp_phase", "lamp_amplitude"],
}
EFFECTS = {
    *("motion", "appearance_change", "emergence", "disappearance", "view_dependence", "lens_distortion"),
    "colour_mismatch",
    "lens_falloff",
    *CORRECTIONS,
}
COEFFICIENTS = {"none": (0,), "opencv": (4, 5, 8), "fisheye": (4,)}
TWO_TO_64 = 1 << 64
ID_END = 1 << 63


@dataclass(frozen=True)
class Limits:
    """What a reader refuses to exceed (section 8): payload bytes and number of Gaussians."""

    payload_bytes: int = 268_435_456
    gaussians: int = 2_097_152


class Broken(Exception):
    """A "must" of the specification is broken: reason code, number and stream offset of the packet (section 9)."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason
        self.packet: int | None = None
        self.offset = 0


def refuse(reason: str) -> NoReturn:
    raise Broken(reason)


@contextmanager
def located(packet: int | None, offset: int) -> Iterator[None]:
    """What breaks in here is in this packet; None is the prologue."""
    try:
        yield
    except Broken as broken:
        broken.packet, broken.offset = packet, offset
        raise


class Fields:
    """The fields of a payload, from its first byte to its last."""

    def __init__(self, payload: bytes) -> None:
        self.payload, self.position = payload, 0

    def take(self, length: int) -> bytes:
        if length > len(self.payload) - self.position:
            refuse("bad-payload")
        self.position += length
        return self.payload[self.position - length : self.position]

    def u8(self) -> int:
        return self.take(1)[0]

    def u32(self) -> int:
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        return int.from_bytes(self.take(8), "little")

    def i32(self) -> int:
        return int.from_bytes(self.take(4), "little", signed=True)

    def finish(self) -> None:
        if self.position != len(self.payload):
            refuse("bad-payload")


# Section 3: the container


@dataclass(frozen=True)
class Packet:
    """One packet: its place in the stream, and its payload after the checks of section 3."""

    number: int
    offset: int
    kind: int
    frame: int
    payload: bytes


def check_prologue(data: bytes) -> None:
    head = data[:8]
    if head != SIGNATURE[: len(head)]:
        damaged = any(len(head) >= 6 and head[: len(form)] == form[: len(head)] for form in TEXT_DAMAGE)
        refuse("text-damage" if damaged else "bad-signature")
    if len(data) < 16:
        refuse("truncated")
    if zlib.crc32(data[:12]) != int.from_bytes(data[12:16], "little"):
        refuse("bad-header-crc")
    if data[8] != 1:
        refuse("unsupported-version")
    if data[10:12] != b"\0\0":
        refuse("reserved-bits")


def packets(data: bytes, limits: Limits) -> Iterator[Packet]:
    """The packets of a whole stream in turn, each checked as far as its container goes."""
    offset, number, ended = 16, 0, False
    while offset < len(data) or number == 0:
        with located(number, offset):
            if ended:
                refuse("trailing-data")
            packet = packet_at(data, offset, number, limits)
        yield packet
        ended = packet.kind == END
        offset += 24 + len(packet.payload)
        number += 1


def packet_at(data: bytes, offset: int, number: int, limits: Limits) -> Packet:
    head = data[offset : offset + 20]
    if head[:4] != SYNC[: len(head)]:
        refuse("bad-sync")
    if len(head) < 20:
        refuse("truncated")
    kind, flags, reserved, frame, length, checksum = struct.unpack("<4xBBHIII", head)
    if zlib.crc32(head[:16]) != checksum:
        refuse("bad-header-crc")
    if flags > 1 or reserved or frame >= 1 << 31:
        refuse("reserved-bits")
    if flags != CRITICAL.get(kind, flags):
        refuse("reserved-bits")
    if kind not in CRITICAL and flags:
        refuse("unknown-critical")
    if length > limits.payload_bytes:
        refuse("too-large")
    if (kind == HEADER) != (number == 0):
        refuse("misplaced-packet")
    payload = data[offset + 20 : offset + 20 + length]
    trailer = data[offset + 20 + length : offset + 24 + length]
    if len(trailer) < 4:
        refuse("truncated")
    if zlib.crc32(payload) != int.from_bytes(trailer, "little"):
        refuse("bad-payload-crc")
    return Packet(number, offset, kind, frame, payload)


def check_end(packet: Packet, frames: int) -> None:
    fields = Fields(packet.payload)
    count, _ = fields.u32(), fields.u64()
    fields.finish()
    if count != frames:
        refuse("index-mismatch")


def index_is_right(packet: Packet, found: list[Packet]) -> bool:
    """Whether a reader that seeks may use this index of the frame packets found before it."""
    count = int.from_bytes(packet.payload[:4], "little")
    if len(packet.payload) != 4 + 16 * count:
        return False
    entries = [struct.unpack_from("<QIB", packet.payload, 4 + 16 * entry) for entry in range(count)]
    return entries == [(frame.offset, frame.frame, frame.kind) for frame in found]
