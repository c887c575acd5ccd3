"""Puts .dgs streams together from the states they tell, field by field: the inverse of plain_decoder.py.

No encoder chooses anything here, so that streams reach what none writes, and break whatever rule a vector is for.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

from plain_container import CORRECTIONS, DELTA, END, FRAME_KINDS, HEADER, INDEX, KEY, SIGNATURE, SKIP, SOUND, Limits
from plain_header import Header, layers_of, presentation_of, profiles_of, sound_of
from plain_payload import Sound
from plain_state import State, digest, mix, wrapped

MISSING = object()


@dataclass(frozen=True)
class Vector:
    """A stream and its outcome when read in order: the states it gives and, if it is broken, reason, packet, offset.

    ``layers``: of each layer above the base, the states of it and those below, up to ``layer_fault``, a reason.
    """

    name: str
    data: bytes
    header: Header | None
    states: tuple[State, ...]
    failure: tuple[str, int | None, int] | None = None
    limits: Limits | None = None
    indexes: tuple[bool, ...] = ()
    sounds: tuple[Sound, ...] = ()
    layers: tuple[tuple[State, ...], ...] = ()
    layer_fault: str | None = None


# Fields of payloads (SPEC.md, section 6), each the inverse of what a decoder reads


Coder = Callable[[bytes], bytes]
Rows = Sequence[Sequence[int]]


def stored(data: bytes) -> bytes:
    return coded(0, data)


def coded(codec: int, data: bytes) -> bytes:
    return struct.pack("<BI", codec, len(data)) + data


def zstd_frame(data: bytes, *, window: int | None = None, declared: int | None = None, blocks: bytes = b"") -> bytes:
    """A zstd frame of raw blocks, or of the given ones; `window` is its descriptor, None for a single segment."""
    declared = len(data) if declared is None else declared
    descriptor = b"\xa0" if window is None else bytes([0x80, window])
    return b"\x28\xb5\x2f\xfd" + descriptor + struct.pack("<I", declared) + (blocks or zstd_block(0, data, last=True))


def zstd_block(kind: int, data: bytes, *, last: bool, size: int | None = None) -> bytes:
    size = len(data) if size is None else size
    return (last | kind << 1 | size << 3).to_bytes(3, "little") + data


def in_zstd(data: bytes) -> bytes:
    return coded(1, zstd_frame(data))


def varint(number: int) -> bytes:
    data = bytearray()
    while number >= 0x80:
        data.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*data, number])


def gap_varints(rows: Sequence[int], before: int = -1) -> bytes:
    return b"".join(varint(row - last - 1) for last, row in pairwise([before, *rows]))


def gaps(rows: Sequence[int], coder: Coder = stored) -> bytes:
    return b"\3" + struct.pack("<I", len(rows)) + coder(gap_varints(rows))


def bitmap(rows: Sequence[int], population: int, coder: Coder = stored) -> bytes:
    bits = bytearray((population + 7) // 8)
    for row in rows:
        bits[row // 8] |= 1 << row % 8
    return b"\2" + coder(bytes(bits))


def some_set(rows: Sequence[int], population: int) -> bytes:
    return bitmap(rows, population) if rows else b"\0"


def zigzag(value: int) -> int:
    return (value << 1 ^ value >> 31) & 0xFFFFFFFF


def planes(columns: Rows, counts: Sequence[int] | None, coder: Coder) -> bytes:
    needed = [max((code.bit_length() + 7) // 8 for code in [0, *column]) for column in columns]
    counts = needed if counts is None else counts
    data = bytearray()
    for plane in range(max(counts)):
        for column, count in zip(columns, counts, strict=True):
            if count > plane:
                data += bytes(code >> 8 * plane & 0xFF for code in column)
    return bytes(counts) + coder(bytes(data))


@dataclass(frozen=True)
class Coding:
    """How one attribute group is written."""

    mode: int = 0
    constants: Sequence[int] = ()
    counts: Sequence[int] | None = None
    coder: Coder = stored


def attribute_group(rows: Rows, width: int, coding: Coding) -> bytes:
    if coding.mode == 3:
        return morton_group(rows, coding)
    columns = [[row[channel] for row in rows] for channel in range(width)]
    head = bytes([coding.mode])
    if coding.mode == 1:
        columns = [[wrapped(b - a) for a, b in zip([0, *column[:-1]], column, strict=True)] for column in columns]
    if coding.mode == 4:
        before = [[0] * len(rows), *columns[:-1]]
        columns = [[b - a for a, b in zip(*pair, strict=True)] for pair in zip(before, columns, strict=True)]
    if coding.mode in (2, 4):
        head += struct.pack(f"<{width}i", *coding.constants)
        columns = [
            [wrapped(value - constant) for value in column]
            for column, constant in zip(columns, coding.constants, strict=True)
        ]
    return head + planes([[zigzag(value) for value in column] for column in columns], coding.counts, coding.coder)


def morton_group(rows: Rows, coding: Coding) -> bytes:
    codes = [morton_code(row, coding.constants) for row in rows]
    steps = [b - a for a, b in zip([0, *codes[:-1]], codes, strict=True)]
    return b"\3" + struct.pack("<3i", *coding.constants) + planes([steps], coding.counts, coding.coder)


def morton_code(mean: Sequence[int], origin: Sequence[int]) -> int:
    above = [(mean[axis] - origin[axis]) % 2**32 for axis in range(3)]
    return sum((above[axis] >> bit & 1) << (3 * bit + axis) for axis in range(3) for bit in range(21))


def groups(rows: Rows, header: Header, codings: dict[int, Coding] | None = None) -> bytes:
    """Presence byte and the groups that are not all zero, or that `codings` asks for."""
    codings, presence, data, start = codings or {}, 0, b"", 0
    for group, width in enumerate(header.channels):
        part = [row[start : start + width] for row in rows]
        start += width
        if group in codings or any(any(row) for row in part):
            presence |= 1 << group
            data += attribute_group(part, width, codings.get(group, Coding()))
    return bytes([presence]) + data


def key_head(state: State, header: Header, *, reference: int = 0, id_mode: int = 0, first_id: int = 0) -> bytes:
    told = digest(state, sum(header.channels))
    return struct.pack("<QQIBBQ", told, state.next_id, len(state.ids), reference, id_mode, first_id)


def corrections_block(corrections: dict[str, dict[str, int]], header: Header) -> bytes:
    numbers = [
        corrections[name][number]
        for effect, fields in CORRECTIONS.items()
        for name in header.corrected.get(effect, [])
        for number in fields
    ]
    return struct.pack(f"<{len(numbers)}h", *numbers)


# Streams


def packet(kind: int, frame: int, payload: bytes, *, flags: int | None = None, reserved: int = 0) -> bytes:
    flags = int(kind in (HEADER, *FRAME_KINDS)) if flags is None else flags
    head = struct.pack("<4sBBHII", b"DGSP", kind, flags, reserved, frame, len(payload))
    return head + checksum(head) + payload + checksum(payload)


def checksum(data: bytes) -> bytes:
    return zlib.crc32(data).to_bytes(4, "little")


def prologue(major: int = 1, minor: int = 0, reserved: int = 0) -> bytes:
    head = SIGNATURE + struct.pack("<BBH", major, minor, reserved)
    return head + checksum(head)


def example_header() -> dict[str, Any]:
    """The header of the worked example."""
    camera = {"cx": 2.0, "cy": 1.5, "distortion": [], "distortion_model": "none", "fx": 5.0, "fy": 5.0, "height": 3}
    pose = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]
    lattice = {"log_scales": 0.25, "means": [0.5, 0.5, 0.5], "opacity_logits": 0.5, "origin": [0.0, 0.0, 0.0]}
    texts = {"axes": "", "units": "", "source_text": "", "licence": "", "writer": ""}
    return {
        "background": [0.0, 0.0, 0.0],
        "cameras": [{**camera, "name": "a", "width": 4, "world_to_camera": pose}],
        "effects": [],
        "first_frame": 0,
        "fps": None,
        "held_out": [],
        "lattice": {**lattice, "quaternions": 0.5, "sh_dc": 0.125, "sh_rest": 0.125},
        "settings": {},
        "sh_degree": 0,
        **texts,
    }


def changed(path: str, value: Any) -> dict[str, Any]:
    """The header of the worked example with one member, or the item of a list, set or left out."""
    document = example_header()
    *parents, name = (int(step) if step.isdigit() else step for step in path.split("."))
    place: Any = document
    for step in parents:
        place = place[step]
    if value is MISSING:
        del place[name]
    else:
        place[name] = value
    return document


def canonical(document: Any) -> bytes:
    return json.dumps(document, sort_keys=True, separators=(",", ":")).encode()


@dataclass
class Stream:
    """A stream under construction, and the states that a decoder must find in it."""

    document: dict[str, Any] = field(default_factory=example_header)
    head: bytes = field(default_factory=prologue)

    def __post_init__(self) -> None:
        corrected = self.document.get("corrected", {})
        told = presentation_of(self.document)
        heard, fps = sound_of(self.document), self.document["fps"]
        degree = self.document["sh_degree"]
        layers, profiles = layers_of(self.document), profiles_of(self.document)
        self.header = Header((degree + 1) ** 2, self.document["lattice"], corrected, told, heard, fps, layers, profiles)
        self.width = sum(self.header.channels)
        self.data = self.head
        self.offsets: list[int] = []
        self.frames: list[tuple[int, int, int]] = []
        self.states: list[State] = []
        self.sounds: list[Sound] = []
        self.corrections: dict[str, dict[str, int]] = {}
        self.add(HEADER, 0, canonical(self.document))

    def add(self, kind: int, frame: int, payload: bytes, **header: int) -> None:
        """One packet, whatever it holds."""
        self.raw(packet(kind, frame, payload, **header))
        if kind in FRAME_KINDS:
            self.frames.append((self.offsets[-1], frame, kind))

    def sound(self, frame: int, first: int, blocks: list[bytes], *, track: int = 0) -> None:
        """Sound of a track, from the sample ``first`` of the stream on."""
        offset = first - math.floor(frame * 48000 / self.header.fps + 0.5)
        coded = b"".join(struct.pack("<H", len(block)) + block for block in blocks)
        self.add(SOUND, frame, struct.pack("<Bi", track, offset) + coded, flags=0)
        self.sounds.append(Sound(track, first, blocks))

    def raw(self, data: bytes) -> None:
        self.offsets.append(len(self.data))
        self.data += data

    def state(self, rows: Rows, *, ids: Sequence[int] | None = None, next_id: int | None = None) -> State:
        """The next frame's state."""
        ids = range(len(rows)) if ids is None else ids
        next_id = (ids[-1] + 1 if len(ids) else 0) if next_id is None else next_id
        return State(len(self.frames), next_id, list(ids), [list(row) for row in rows])

    def told(self, kind: int, state: State, payload: bytes) -> None:
        """A frame packet, with the corrections at hand."""
        self.add(kind, state.frame, corrections_block(self.corrections, self.header) + payload)
        self.states.append(replace(state, corrections=self.corrections))

    def key(self, state: State, codings: dict[int, Coding] | None = None, *, coder: Coder = stored) -> None:
        """A key packet that refers to nothing; ids are listed when they are not consecutive."""
        first = state.ids[0] if state.ids else 0
        listed = state.ids != list(range(first, first + len(state.ids)))
        ids = coder(gap_varints(state.ids[1:], first)) if listed else b""
        head = key_head(state, self.header, id_mode=int(listed), first_id=first)
        self.told(KEY, state, head + ids + groups(state.rows, self.header, codings))

    def delta(
        self,
        residuals: dict[int, Sequence[int]] | None = None,
        removed: Sequence[int] = (),
        added: Rows = (),
        *,
        touched_set: bytes | None = None,
        removed_set: bytes | None = None,
        codings: dict[int, Coding] | None = None,
    ) -> None:
        """A delta packet: residuals by row, rows that go, Gaussians that come."""
        before, residuals = self.states[-1], residuals or {}
        population, next_id = len(before.ids), before.next_id + len(added)
        after = self.state(
            [*changed_rows(before, residuals, removed), *added],
            ids=[*kept_ids(before, removed), *range(before.next_id, next_id)],
            next_id=next_id,
        )
        payload = struct.pack("<Q", digest(after, self.width))
        payload += self.changes(residuals, removed, population, touched_set, removed_set, codings)
        payload += struct.pack("<I", len(added)) + (groups(added, self.header) if added else b"")
        self.told(DELTA, after, payload)

    def changes(
        self,
        residuals: dict[int, Sequence[int]],
        removed: Sequence[int],
        population: int,
        touched_set: bytes | None = None,
        removed_set: bytes | None = None,
        codings: dict[int, Coding] | None = None,
    ) -> bytes:
        rows = sorted(residuals)
        touched_set = some_set(rows, population) if touched_set is None else touched_set
        removed_set = some_set(removed, population) if removed_set is None else removed_set
        told = groups([residuals[row] for row in rows], self.header, codings) if rows else b""
        return touched_set + told + removed_set

    def referring_key(
        self,
        residuals: dict[int, Sequence[int]] | None = None,
        removed: Sequence[int] = (),
        added: Rows = (),
        ids: Sequence[int] = (),
        *,
        next_id: int,
        id_mode: int = 0,
    ) -> None:
        """A key packet that tells the state as a change of the first keyframe's."""
        first, residuals = self.states[0], residuals or {}
        rows = [*changed_rows(first, residuals, removed), *added]
        after = self.state(rows, ids=[*kept_ids(first, removed), *ids], next_id=next_id)
        payload = key_head(after, self.header, reference=1, id_mode=id_mode, first_id=ids[0] if ids else 0)
        payload += self.changes(residuals, removed, len(first.ids)) + struct.pack("<I", len(added))
        if added:
            payload += (stored(gap_varints(ids[1:], ids[0])) if id_mode else b"") + groups(added, self.header)
        self.told(KEY, after, payload)

    def skip(self) -> None:
        before = self.states[-1]
        after = self.state(before.rows, ids=before.ids, next_id=before.next_id)
        self.told(SKIP, after, struct.pack("<Q", digest(after, self.width)))

    def index(self, entries: Sequence[tuple[int, int, int]] | None = None) -> None:
        entries = self.frames if entries is None else entries
        listed = b"".join(struct.pack("<QIB3x", *entry) for entry in entries)
        self.add(INDEX, 0, struct.pack("<I", len(entries)) + listed)

    def end(self, *, with_index: bool = True) -> None:
        self.add(END, 0, struct.pack("<IQ", len(self.frames), self.offsets[-1] if with_index else 0))

    def finish(self) -> None:
        self.index()
        self.end()

    def good(self, name: str, *, limits: Limits | None = None, indexes: Sequence[bool] = ()) -> Vector:
        return Vector(
            name, self.data, self.header, tuple(self.states), None, limits, tuple(indexes), tuple(self.sounds)
        )

    def broken(self, name: str, reason: str, *, limits: Limits | None = None, indexes: Sequence[bool] = ()) -> Vector:
        """The vector of a stream whose last packet is broken."""
        failure = reason, len(self.offsets) - 1, self.offsets[-1]
        header = self.header if len(self.offsets) > 1 else None
        return Vector(name, self.data, header, tuple(self.states), failure, limits, tuple(indexes))


def changed_rows(before: State, residuals: dict[int, Sequence[int]], removed: Sequence[int]) -> list[list[int]]:
    rows = [list(row) for row in before.rows]
    for row, steps in residuals.items():
        rows[row] = [wrapped(value + step) for value, step in zip(rows[row], steps, strict=True)]
    return [row for number, row in enumerate(rows) if number not in removed]


def kept_ids(before: State, removed: Sequence[int]) -> list[int]:
    return [name for row, name in enumerate(before.ids) if row not in removed]


# Scenes


def scene(seed: int, count: int, width: int, size: int = 300) -> list[list[int]]:
    """Rows of integers from -size to size."""
    return [[mix((seed << 32) + row * width + c) % (2 * size + 1) - size for c in range(width)] for row in range(count)]


def in_morton_order(rows: Rows) -> tuple[list[list[int]], list[int]]:
    """The rows sorted by Morton code, and the lowest position."""
    origin = [min(row[axis] for row in rows) for axis in range(3)]
    return sorted((list(row) for row in rows), key=lambda row: morton_code(row, origin)), origin


def with_degree(degree: int) -> Stream:
    return Stream(changed("sh_degree", degree))


def opened(count: int = 5, **header: Any) -> Stream:
    """A stream with one keyframe."""
    stream = Stream(**header)
    stream.key(stream.state(scene(1, count, stream.width)))
    return stream
