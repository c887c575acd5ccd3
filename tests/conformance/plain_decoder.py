"""A decoder of .dgs streams in plain Python, written from formats/SPEC.md alone: the specification's proof.

It shares no code with the package, and uses the standard library and, for zstd frames (RFC 8878), `zstandard`. It is
slow on purpose: lists of integers, one step of the specification after the other. Section numbers are SPEC.md's.
"""

from __future__ import annotations

import json
import math
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import zstandard

SIGNATURE = bytes.fromhex("8b4447530d0a1a0a")
TEXT_DAMAGE = tuple(map(bytes.fromhex, ("8b4447530a1a0a", "8b4447530d0d0a1a0d0a", "0b4447530d0a1a0a")))
SYNC = b"DGSP"
HEADER, KEY, DELTA, SKIP, INDEX, END, METRICS = range(1, 8)
FRAME_KINDS = (KEY, DELTA, SKIP)
CRITICAL = {HEADER: 1, KEY: 1, DELTA: 1, SKIP: 1, INDEX: 0, END: 0, METRICS: 0}
MEANS, LOG_SCALES, QUATERNIONS, OPACITY_LOGITS, SH_DC, SH_REST = range(6)
VALUES, RESIDUALS = "values", "residuals"
CORRECTIONS = {
    "exposure_drift": ["exposure"],
    "white_balance_drift": ["red", "blue"],
    "camera_shake": ["yaw", "pitch", "roll"],
}
EFFECTS = {
    *("motion", "appearance_change", "emergence", "disappearance", "view_dependence", "lens_distortion"),
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


@dataclass(frozen=True)
class State:
    """The scene after a frame (section 5): rows of integers, each with an id; and what is told of its cameras."""

    frame: int
    next_id: int
    ids: list[int]
    rows: list[list[int]]
    corrections: dict[str, dict[str, int]] = field(default_factory=dict)


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


# Section 4: the header packet


@dataclass(frozen=True)
class Header:
    """What decoding needs of the header packet: the number of SH coefficients, the lattice, corrected cameras."""

    coefficients: int
    lattice: dict[str, Any]
    corrected: dict[str, list[str]] = field(default_factory=dict)

    @property
    def channels(self) -> list[int]:
        return [3, 3, 4, 1, 3, 3 * (self.coefficients - 1)]


def read_header(payload: bytes) -> Header:
    if len(payload) > 1 << 20:
        refuse("too-large")
    header = read_json(payload)
    expect(isinstance(header, dict))
    check_header(header)
    if any(name not in EFFECTS for name in header["effects"]):
        refuse("unsupported-effect")
    return Header((header["sh_degree"] + 1) ** 2, header["lattice"], header.get("corrected", {}))


def expect(condition: bool) -> None:
    if not condition:
        refuse("bad-header")


def read_json(payload: bytes) -> Any:
    try:
        text = payload.decode("utf-8")
        check_nesting(text)
        return json.loads(
            text,
            object_pairs_hook=json_object,
            parse_float=json_number,
            parse_int=json_integer,
            parse_constant=lambda _: refuse("bad-header"),
        )
    except ValueError:
        refuse("bad-header")


def check_nesting(text: str) -> None:
    depth, in_text, escaped = 0, False, False
    for character in text:
        if escaped:
            escaped = False
        elif in_text:
            escaped = character == "\\"
            in_text = character != '"'
        elif character == '"':
            in_text = True
        elif character in "[{":
            depth += 1
            expect(depth <= 16)
        elif character in "]}":
            depth -= 1


def json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    expect(len(members) == len(pairs))
    for name, value in pairs:
        expect_unicode(name)
        expect_unicode(value)
    return members


def expect_unicode(value: Any) -> None:
    if isinstance(value, str):
        expect(not any(0xD800 <= ord(character) < 0xE000 for character in value))
    elif isinstance(value, list):
        for item in value:
            expect_unicode(item)


def json_number(text: str) -> float:
    expect(math.isfinite(float(text)))
    return float(text)


def json_integer(text: str) -> int:
    json_number(text)
    return int(text)


def is_number(value: Any, least: float, most: float) -> bool:
    return type(value) in (int, float) and least <= value <= most


def is_integer(value: Any, least: int, most: int) -> bool:
    return type(value) is int and least <= value <= most


def is_vector(value: Any, length: int, least: float, most: float) -> bool:
    return isinstance(value, list) and len(value) == length and all(is_number(item, least, most) for item in value)


def is_name(value: Any) -> bool:
    if not isinstance(value, str) or not 1 <= len(value) <= 255 or value in (".", ".."):
        return False
    return not any(ord(c) < 32 or 127 <= ord(c) < 160 or c in "/\\" for c in value)


def is_names(value: Any) -> bool:
    return isinstance(value, list) and len(value) <= 1024 and all(map(is_name, value))


def check_header(header: dict[str, Any]) -> None:
    needed = "cameras lattice sh_degree fps first_frame background effects held_out axes units source_text licence"
    expect(all(name in header for name in [*needed.split(), "writer", "settings"]))
    cameras = header["cameras"]
    expect(isinstance(cameras, list) and 1 <= len(cameras) <= 1024)
    for camera in cameras:
        check_camera(camera)
    names = [camera["name"] for camera in cameras]
    expect(len(set(names)) == len(names))
    check_lattice(header["lattice"])
    expect(is_integer(header["sh_degree"], 0, 3))
    expect(header["fps"] is None or is_number(header["fps"], 1e-6, 1e6))
    expect(is_integer(header["first_frame"], 0, 2**31 - 1))
    expect(is_vector(header["background"], 3, -1000, 1000))
    expect(is_names(header["effects"]))
    expect(is_names(header["held_out"]) and set(header["held_out"]) <= set(names))
    check_corrected(header, set(names) - set(header["held_out"]))
    for text in ("axes", "units", "source_text", "licence", "writer"):
        expect(isinstance(header[text], str) and len(header[text]) <= 65_536)
    expect(isinstance(header["settings"], dict))


def check_corrected(header: dict[str, Any], seen: set[str]) -> None:
    corrected = header.get("corrected", {})
    expect(isinstance(corrected, dict))
    for effect in CORRECTIONS:
        names = corrected.get(effect, [])
        expect(is_names(names) and len(set(names)) == len(names) and set(names) <= seen)
        expect(bool(names) == (effect in header["effects"]))


def check_camera(camera: Any) -> None:
    expect(isinstance(camera, dict))
    needed = "name width height fx fy cx cy distortion_model distortion world_to_camera"
    expect(all(name in camera for name in needed.split()))
    expect(is_name(camera["name"]))
    expect(is_integer(camera["width"], 1, 32_768) and is_integer(camera["height"], 1, 32_768))
    expect(is_number(camera["fx"], 1e-3, 1e9) and is_number(camera["fy"], 1e-3, 1e9))
    expect(is_number(camera["cx"], -1e9, 1e9) and is_number(camera["cy"], -1e9, 1e9))
    model, distortion = camera["distortion_model"], camera["distortion"]
    expect(isinstance(model, str) and model in COEFFICIENTS and isinstance(distortion, list))
    expect(len(distortion) in COEFFICIENTS[model] and is_vector(distortion, len(distortion), -1e6, 1e6))
    rows = camera["world_to_camera"]
    expect(isinstance(rows, list) and len(rows) == 3 and all(is_vector(row, 4, -1e12, 1e12) for row in rows))
    check_rotation([row[:3] for row in rows])
    expect(is_number(camera.get("near", 0), 0, 1e12))


def check_rotation(r: list[list[float]]) -> None:
    for i in range(3):
        for j in range(3):
            product = sum(r[i][axis] * r[j][axis] for axis in range(3))
            expect(abs(product - (i == j)) <= 0.01)
    minors = [r[1][(a + 1) % 3] * r[2][(a + 2) % 3] - r[1][(a + 2) % 3] * r[2][(a + 1) % 3] for a in range(3)]
    expect(sum(r[0][axis] * minors[axis] for axis in range(3)) > 0)


def check_lattice(lattice: Any) -> None:
    expect(isinstance(lattice, dict))
    scalars = ("log_scales", "quaternions", "opacity_logits", "sh_dc", "sh_rest")
    expect(all(name in lattice for name in ("origin", "means", *scalars)))
    expect(is_vector(lattice["origin"], 3, -1e12, 1e12) and is_vector(lattice["means"], 3, 1e-12, 1e6))
    expect(all(is_number(lattice[name], 1e-12, 1e6) for name in scalars) and lattice["quaternions"] <= 0.5)


# Section 5: state and lattice


def wrapped(integer: int) -> int:
    """The integer modulo 2^32, in two's complement."""
    return (integer + 2**31) % 2**32 - 2**31


def mix(z: int) -> int:
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % TWO_TO_64
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB % TWO_TO_64
    return z ^ (z >> 31)


def digest(state: State, channels: int) -> int:
    keys = [mix((j + 1) * 0x9E3779B97F4A7C15 % TWO_TO_64) | 1 for j in range(channels + 1)]
    total = 0
    for name, row in zip(state.ids, state.rows, strict=True):
        products = (key * value for key, value in zip(keys[1:], row, strict=True))
        total += mix((keys[0] * name + sum(products)) % TWO_TO_64)
    return mix((mix((mix(total % TWO_TO_64) + len(state.ids)) % TWO_TO_64) + state.next_id) % TWO_TO_64)


def floats(state: State, header: Header) -> list[list[float]]:
    """Mean, log-scales, quaternion, opacity logit and SH of each row, in float64; float32 is one rounding away."""
    lattice = header.lattice
    shown = []
    for row in state.rows:
        means = [row[axis] * lattice["means"][axis] + lattice["origin"][axis] for axis in range(3)]
        log_scales = [min(max(value * lattice["log_scales"], -40.0), 40.0) for value in row[3:6]]
        quaternion = [value * lattice["quaternions"] for value in row[6:10]] if any(row[6:10]) else [1.0, 0.0, 0.0, 0.0]
        opacity_logit = min(max(row[10] * lattice["opacity_logits"], -80.0), 80.0)
        sh_dc = [value * lattice["sh_dc"] for value in row[11:14]]
        sh_rest = [value * lattice["sh_rest"] for value in row[14:]]
        shown.append([*means, *log_scales, *quaternion, opacity_logit, *sh_dc, *sh_rest])
    return shown


# Section 6: payloads


def coded_block(fields: Fields, least: int, most: int) -> bytes:
    """The data of a block that decodes to `least` to `most` bytes."""
    codec = fields.u8()
    if codec > 1:
        refuse("unsupported-mode")
    data = fields.take(fields.u32())
    if codec == 1:
        return zstd_frame(data, least, most)
    if not least <= len(data) <= most:
        refuse("bad-payload")
    return data


def zstd_frame(data: bytes, least: int, most: int) -> bytes:
    try:
        frame = zstandard.get_frame_parameters(data)
        in_bounds = max(least, 1) <= frame.content_size <= most and frame.window_size <= 1 << 23
        if data[:4] != zstandard.FRAME_HEADER or not in_bounds or frame.dict_id:
            refuse("bad-compression")
        decompression = zstandard.ZstdDecompressor(max_window_size=1 << 23).decompressobj()
        content = decompression.decompress(data)
    except zstandard.ZstdError:
        refuse("bad-compression")
    if not decompression.eof or decompression.unused_data or len(content) != frame.content_size:
        refuse("bad-compression")
    return content


def varints(block: bytes, count: int) -> list[int]:
    numbers, position = [], 0
    for _ in range(count):
        number, length, byte = 0, 0, 0x80
        while byte & 0x80:
            if position == len(block) or length == 5:
                refuse("bad-index-set")
            byte = block[position]
            number |= (byte & 0x7F) << (7 * length)
            position, length = position + 1, length + 1
        if byte == 0 and length > 1:
            refuse("bad-index-set")
        numbers.append(number)
    if position != len(block):
        refuse("bad-index-set")
    return numbers


def index_set(fields: Fields, rows: int) -> list[int]:
    tag = fields.u8()
    if tag == 0:
        return []
    if tag == 1:
        return list(range(rows))
    if tag == 2:
        return bitmap(fields, rows)
    if tag == 3:
        return gaps(fields, rows)
    refuse("unsupported-mode")


def bitmap(fields: Fields, rows: int) -> list[int]:
    size = (rows + 7) // 8
    bits = coded_block(fields, size, size)
    chosen = [row for row in range(8 * size) if bits[row // 8] >> (row % 8) & 1]
    if chosen and chosen[-1] >= rows:
        refuse("bad-index-set")
    return chosen


def gaps(fields: Fields, rows: int) -> list[int]:
    count = fields.u32()
    if not 1 <= count <= rows:
        refuse("bad-index-set")
    chosen, row = [], -1
    for distance in varints(coded_block(fields, count, 5 * count), count):
        row += distance + 1
        chosen.append(row)
    if row >= rows:
        refuse("bad-index-set")
    return chosen


def attribute_group(fields: Fields, group: int, channels: int, rows: int, role: str) -> list[list[int]]:
    """One group of so many rows, as rows of channels, after prediction."""
    mode = fields.u8()
    if mode > 4 or (mode > 0 and role == RESIDUALS) or (mode == 3 and group != MEANS):
        refuse("unsupported-mode")
    constants = [fields.i32() for _ in range(channels)] if mode >= 2 else [0] * channels
    if mode == 3:
        codes = planes(fields, 1, rows, 8)[0]
        return morton_positions(codes, constants)
    columns = []
    for codes, constant in zip(planes(fields, channels, rows, 4), constants, strict=True):
        residuals = [(code >> 1) ^ -(code & 1) for code in codes]
        columns.append(predicted(residuals, mode, constant))
        if mode == 4 and len(columns) > 1:
            columns[-1] = [wrapped(value + before) for value, before in zip(columns[-1], columns[-2], strict=True)]
    return [list(row) for row in zip(*columns, strict=True)]


def planes(fields: Fields, channels: int, rows: int, most: int) -> list[list[int]]:
    """The unsigned codes of each channel."""
    counts = list(fields.take(channels))
    if any(count > most for count in counts):
        refuse("bad-payload")
    block = coded_block(fields, rows * sum(counts), rows * sum(counts))
    codes, position = [[0] * rows for _ in range(channels)], 0
    for plane in range(most):
        for channel in range(channels):
            if counts[channel] > plane:
                for row in range(rows):
                    codes[channel][row] |= block[position + row] << (8 * plane)
                position += rows
    return codes


def predicted(residuals: list[int], mode: int, constant: int) -> list[int]:
    if mode != 1:
        return [wrapped(residual + constant) for residual in residuals]
    total, sums = 0, []
    for residual in residuals:
        total += residual
        sums.append(wrapped(total))
    return sums


def morton_positions(steps: list[int], constants: list[int]) -> list[list[int]]:
    code, positions = 0, []
    for step in steps:
        code += step
        if code >= 1 << 63:
            refuse("bad-payload")
        position = [sum((code >> (3 * bit + axis) & 1) << bit for bit in range(21)) for axis in range(3)]
        positions.append([wrapped(position[axis] + constants[axis]) for axis in range(3)])
    return positions


def groups(fields: Fields, header: Header, rows: int, role: str) -> list[list[int]]:
    """Presence byte and groups: the integers of each row, zero where a group is not present."""
    presence = fields.u8()
    if presence >> 6 or (presence >> SH_REST & 1 and header.coefficients == 1):
        refuse("reserved-bits")
    table: list[list[int]] = [[] for _ in range(rows)]
    for group, channels in enumerate(header.channels):
        if presence >> group & 1:
            integers = attribute_group(fields, group, channels, rows, role)
        else:
            integers = [[0] * channels for _ in range(rows)]
        for row, values in zip(table, integers, strict=True):
            row.extend(values)
    return table


def changed_rows(fields: Fields, header: Header, rows: list[list[int]]) -> tuple[list[list[int]], set[int]]:
    """Section 7, step 1, and the rows that step 2 takes away."""
    changed = [list(row) for row in rows]
    touched = index_set(fields, len(rows))
    if touched:
        for row, residuals in zip(touched, groups(fields, header, len(touched), RESIDUALS), strict=True):
            changed[row] = [wrapped(a + b) for a, b in zip(changed[row], residuals, strict=True)]
    return changed, set(index_set(fields, len(rows)))


def listed_ids(fields: Fields, id_mode: int, first: int, count: int) -> list[int]:
    if id_mode == 0:
        return list(range(first, first + count))
    others = max(0, count - 1)
    ids = [first] * min(count, 1)
    for distance in varints(coded_block(fields, others, 5 * others), others):
        ids.append(ids[-1] + distance + 1)
    return ids


def corrections(packet: Packet, header: Header) -> tuple[dict[str, dict[str, int]], Packet]:
    """What a frame tells of its cameras, and the packet behind that."""
    fields, told = Fields(packet.payload), {}
    for effect, numbers in CORRECTIONS.items():
        for name in header.corrected.get(effect, []):
            for number in numbers:
                value = int.from_bytes(fields.take(2), "little", signed=True)
                told.setdefault(name, {})[number] = value
    return told, replace(packet, payload=packet.payload[fields.position :])


def key(packet: Packet, header: Header, first_key: State | None, limits: Limits) -> tuple[int, State]:
    """The digest in a key packet and the state that it tells."""
    fields = Fields(packet.payload)
    told, next_id, count = fields.u64(), fields.u64(), fields.u32()
    if next_id >= ID_END:
        refuse("bad-payload")
    if count > limits.gaussians:
        refuse("too-many-gaussians")
    reference, id_mode = fields.u8(), fields.u8()
    if reference > 1 or id_mode > 1:
        refuse("unsupported-mode")
    first_listed = fields.u64()
    ids: list[int] = []
    rows: list[list[int]] = []
    listed = count
    if reference == 1:
        if first_key is None:
            refuse("missing-key")
        changed, removed = changed_rows(fields, header, first_key.rows)
        kept = [row for row in range(len(changed)) if row not in removed]
        ids, rows = [first_key.ids[row] for row in kept], [changed[row] for row in kept]
        listed = fields.u32()
        if count != len(kept) + listed:
            refuse("bad-payload")
        if listed and first_listed < first_key.next_id:
            refuse("bad-payload")
    if listed == 0 and first_listed != 0:
        refuse("bad-payload")
    if listed or reference == 0:
        ids = ids + listed_ids(fields, id_mode, first_listed, listed)
        rows = rows + groups(fields, header, listed, VALUES)
    if ids and ids[-1] >= next_id:
        refuse("bad-payload")
    fields.finish()
    return told, State(packet.frame, next_id, ids, rows)


def delta(packet: Packet, header: Header, before: State, limits: Limits) -> tuple[int, State]:
    """The digest in a delta packet and the state that it leads to (section 7)."""
    fields = Fields(packet.payload)
    told = fields.u64()
    changed, removed = changed_rows(fields, header, before.rows)
    kept = [row for row in range(len(changed)) if row not in removed]
    added = fields.u32()
    if len(kept) + added > limits.gaussians:
        refuse("too-many-gaussians")
    next_id = before.next_id + added
    if next_id >= ID_END:
        refuse("bad-payload")
    ids = [before.ids[row] for row in kept] + list(range(before.next_id, next_id))
    rows = [changed[row] for row in kept]
    if added:
        rows = rows + groups(fields, header, added, VALUES)
    fields.finish()
    return told, State(packet.frame, next_id, ids, rows)


def skip(packet: Packet, before: State) -> tuple[int, State]:
    fields = Fields(packet.payload)
    told = fields.u64()
    fields.finish()
    return told, State(packet.frame, before.next_id, before.ids, before.rows)


# Section 7: frame by frame


@dataclass(frozen=True)
class Decoded:
    """A stream read in order as far as it can be: header, the state after each frame, and why it stops, if it does.

    `indexes` tells of each index packet, for which a reader that does not seek has no use, whether it is right.
    """

    header: Header | None
    states: list[State]
    failure: Broken | None
    indexes: list[bool]


def decode(data: bytes, limits: Limits | None = None) -> Decoded:
    """Decode a whole stream from its first byte to its last."""
    header: Header | None = None
    states: list[State] = []
    frames: list[Packet] = []
    indexes: list[bool] = []
    limits = limits or Limits()
    try:
        with located(None, 0):
            check_prologue(data)
        for packet in packets(data, limits):
            with located(packet.number, packet.offset):
                if packet.kind == HEADER:
                    header = read_header(packet.payload)
                elif packet.kind == INDEX:
                    indexes.append(index_is_right(packet, frames))
                elif packet.kind == END:
                    check_end(packet, len(frames))
                elif packet.kind in FRAME_KINDS:
                    states.append(frame(packet, header, states, limits))
                    frames.append(packet)
    except Broken as broken:
        return Decoded(header, states, broken, indexes)
    return Decoded(header, states, None, indexes)


def frame(packet: Packet, header: Header, states: list[State], limits: Limits) -> State:
    if packet.kind != KEY and not states:
        refuse("missing-key")
    if packet.frame != len(states):
        refuse("frame-order")
    faults, packet = corrections(packet, header)
    if packet.kind == KEY:
        told, state = key(packet, header, states[0] if states else None, limits)
    elif packet.kind == DELTA:
        told, state = delta(packet, header, states[-1], limits)
    else:
        told, state = skip(packet, states[-1])
    if digest(state, sum(header.channels)) != told:
        refuse("digest-mismatch")
    return replace(state, corrections=faults)


def main() -> int:
    """Print the digest of each frame of the stream named on the command line, and why decoding stops."""
    decoded = decode(Path(sys.argv[1]).read_bytes())
    for state in decoded.states:
        channels = sum(decoded.header.channels) if decoded.header else 0
        print(f"frame {state.frame}: {len(state.ids)} Gaussians, digest {digest(state, channels):016x}")
    if decoded.failure is None:
        return 0
    print(f"{decoded.failure.reason} in packet {decoded.failure.packet} at byte {decoded.failure.offset}")
    return 2


if __name__ == "__main__":
    sys.exit(main())
