"""Section 6 of the plain decoder: what the payload of a frame tells."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import zstandard
from plain_container import (
    CORRECTIONS,
    ID_END,
    MEANS,
    RESIDUALS,
    SH_REST,
    VALUES,
    Broken,
    Fields,
    Limits,
    Packet,
    refuse,
)
from plain_header import Header
from plain_state import State, wrapped

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


@dataclass(frozen=True)
class Sound:
    """Blocks of a track, and the sample with which the first one begins."""

    track: int
    first: int
    blocks: list[bytes]


def sound(packet: Packet, header: Header, frame: int) -> list[Sound]:
    """What a SOUND packet behind this frame holds; nothing where it is damaged, which costs its own sound alone."""
    fields, blocks = Fields(packet.payload), []
    try:
        track, offset = fields.u8(), fields.i32()
        if track >= len(header.sound) or packet.frame != frame:
            refuse("bad-payload")
        while not blocks or fields.position < len(packet.payload):
            length = int.from_bytes(fields.take(2), "little")
            if not 1 <= length <= 1276 or len(blocks) == 1024:
                refuse("bad-payload")
            blocks.append(fields.take(length))
    except Broken:
        return []
    return [Sound(track, math.floor(packet.frame * 48000 / header.fps + 0.5) + offset, blocks)]
