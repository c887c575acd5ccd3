"""formats/SPEC.md and the code say the same: reason codes, limits, and the worked example byte by byte."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np

from decogs.codec.coding import entropy
from decogs.codec.header import header
from decogs.codec.header.header import StreamHeader
from decogs.codec.packets import corrections, sound
from decogs.codec.packets.deltas import difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene import lattice, state
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import Lattice
from decogs.codec.scene.state import Attributes, take_rows
from decogs.formats.cameras import Camera
from decogs.formats.stream import container
from decogs.formats.stream.container import PacketKind, StreamWriter
from decogs.formats.stream.reasons import ALL_REASONS
from packets import iterate_packets

SPEC = (Path(__file__).resolve().parents[2] / "formats" / "SPEC.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    """The text of one chapter."""
    return re.split(r"^## ", SPEC.split(f"\n## {title}\n", 1)[1], maxsplit=1, flags=re.MULTILINE)[0]


def example_stream() -> bytes:
    """Three Gaussians, then one of them moves, one goes and one comes, then nothing happens."""
    header = StreamHeader(
        cameras=(Camera("a", 4, 3, 5.0, 5.0, 2.0, 1.5, np.eye(4)),),
        lattice=Lattice((0.0, 0.0, 0.0), (0.5, 0.5, 0.5), 0.25, 0.5, 0.5, 0.125, 0.125),
        axes="",
        units="",
        writer="",
    )

    def gaussians(*rows: list[int]) -> Attributes:
        table = np.array(rows, np.int32)
        return Attributes(table[:, :3], table[:, 3:6], table[:, 6:10], table[:, 10], table[:, 11:].reshape(-1, 1, 3))

    first = gaussians(
        [1, 1, 0, -4, -4, -4, 2, 0, 0, 0, 3, 8, 0, 0],
        [-2, 0, 0, -4, -5, -4, 2, 1, 0, 0, 3, 0, 8, 0],
        [300, 1, 2, -4, -4, -6, 2, 0, 0, 0, 3, 0, 0, 8],
    )
    key, _ = keyframe_state(first)
    moved = take_rows(key, np.array([1]))
    moved.means[0] += [2, 0, -1]
    change = difference(
        key, np.array([1]), moved, removed=np.array([2]), added=gaussians([5, 5, 5, -4, -4, -4, 2, 0, 0, 0, 3, 1, 1, 1])
    )
    file = io.BytesIO()
    writer = StreamWriter(file, header.to_bytes())
    writer.write(PacketKind.KEY, 0, write_key(key).payload)
    delta = write_delta(key, change).payload
    writer.write(PacketKind.DELTA, 1, delta)
    last = reconstruct(key, container.Packet(PacketKind.DELTA, 1, delta), header)
    writer.write(PacketKind.SKIP, 2, write_skip(last).payload)
    writer.finish()
    return file.getvalue()


def printed_example() -> bytes:
    block = re.search(r"```hex\n(.*?)```", section("12 Worked example"), re.DOTALL)
    assert block is not None
    return bytes.fromhex(block.group(1))


def test_the_printed_example_is_what_the_encoder_writes() -> None:
    assert printed_example().hex() == example_stream().hex()


def test_the_example_is_explained_byte_by_byte() -> None:
    data, position = printed_example(), 0
    rows = re.findall(r"^\| (\d+) \| `([0-9a-f ]+|\{.*?)` \|", section("12 Worked example"), re.MULTILINE)
    for offset, text in rows:
        field = text.encode() if text.startswith("{") else bytes.fromhex(text)
        assert int(offset) == position
        assert data[position : position + len(field)] == field
        position += len(field)
    assert position == len(data)


def test_the_example_decodes_to_the_printed_state() -> None:
    packets = list(iterate_packets(io.BytesIO(printed_example())))
    stream_header, decoded = StreamHeader.from_bytes(packets[0].payload), None
    for packet in packets[1:4]:
        decoded = reconstruct(decoded, packet, stream_header)
    printed = re.findall(r"^\| id (\d+) \|(.*)\|$", section("12 Worked example"), re.MULTILINE)
    assert [int(number) for number, _ in printed] == decoded.ids.tolist()
    for row, (_, cells) in enumerate(printed):
        numbers = [int(number) for number in re.findall(r"-?\d+", cells)]
        arrays = (decoded.means, decoded.log_scales, decoded.quaternions, decoded.opacity_logits, decoded.sh)
        assert numbers == [value for array in arrays for value in np.ravel(array[row]).tolist()]
    assert f"{digest(decoded):016x}" in section("12 Worked example")


def test_reason_codes_of_the_specification_are_those_of_the_code() -> None:
    assert set(re.findall(r"^\| `([a-z-]+)` \|", section("9 Reason codes"), re.MULTILINE)) == ALL_REASONS


def test_packet_kinds_of_the_specification_are_those_of_the_code() -> None:
    printed = re.findall(r"^\| (\d+) \| ([A-Z]+) \| (critical|ancillary) \|", section("3 Container"), re.MULTILINE)
    expected = {(k.value, k.name, "critical" if k in container.CRITICAL_KINDS else "ancillary") for k in PacketKind}
    assert {(int(value), name, bit) for value, name, bit in printed} == expected


def test_limits_of_the_specification_are_those_of_the_code() -> None:
    printed = dict(re.findall(r"^\| ([A-Za-z].*?) \| ([\d,.]+) \|", section("8 Limits"), re.MULTILINE))
    expected = {
        "payload bytes": container.MAX_PAYLOAD,
        "frame index": container.MAX_FRAME,
        "header bytes": header.MAX_HEADER_BYTES,
        "header nesting": header.MAX_DEPTH,
        "cameras": header.MAX_CAMERAS,
        "image side in pixels": header.MAX_SIDE,
        "Gaussians": state.MAX_GAUSSIANS,
        "Gaussians, reader's default": state.DEFAULT_MAX_GAUSSIANS,
        "id": state.MAX_ID,
        "zstd window in bytes": entropy.MAX_WINDOW,
        "corrections block in bytes": 2 * sum(map(len, corrections.EFFECT_FIELDS.values())) * header.MAX_CAMERAS,
        "tracks of sound": sound.MAX_TRACKS,
        "blocks in a sound packet": sound.MAX_BLOCKS,
        "sound packets of a frame that are looked at": sound.MAX_PACKETS,
        "log-scale magnitude when decoded": lattice.LOG_SCALE_BOUND,
        "opacity logit magnitude when decoded": lattice.OPACITY_LOGIT_BOUND,
    }
    assert {name: int(value.replace(",", "")) for name, value in printed.items()} == expected
