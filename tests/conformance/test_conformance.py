"""The vectors, the plain decoder and the product say the same: states, reason codes, packets and offsets."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from damaged_streams import EVERY
from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import EFFECT_FIELDS, Corrections
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.frame_payload import split_payload
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.sound import frame_start, read_sound
from decogs.codec.packets.syntax import write_delta, write_key, write_skip
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import default_lattice, dequantise
from decogs.codec.scene.state import ARRAYS, Attributes, State
from decogs.decoder import info
from decogs.decoder.commands import decode_main, export_main, info_main
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import (
    FRAME_KINDS,
    Packet,
    PacketKind,
    StreamWriter,
    parse_index,
    read_packet_at,
)
from decogs.formats.stream.reasons import ALL_REASONS
from packets import iterate_packets

sys.path.insert(0, str(Path(__file__).parent))
import limit_vectors
import make_vectors
import plain_container
import plain_decoder
import plain_layers
import stream_writer

from encode_rig import encode_rig as encode

KEPT = {version: make_vectors.kept(version) for version in make_vectors.VERSIONS}
FILES = {name: data for kept in KEPT.values() for name, data in kept.items()}
EXPECTED: dict[str, dict[str, Any]] = {
    name: outcome for kept in KEPT.values() for name, outcome in json.loads(kept["expected.json"]).items()
}
LAYERED = sorted(name for name, expected in EXPECTED.items() if "layers" in expected)
HEARD = "good/sound-that-is-damaged"
GOOD = sorted(name for name, expected in EXPECTED.items() if expected["failure"] is None)
BROKEN = sorted(set(EXPECTED) - set(GOOD))


def vector(name: str) -> bytes:
    return FILES[f"{name}.dgs"]


def vector_file(name: str, folder: Path) -> Path:
    path = folder / "vector.dgs"
    path.write_bytes(vector(name))
    return path


@dataclass(frozen=True)
class Outcome:
    """What a decoder made of a stream."""

    frames: list[dict[str, Any]]
    reason: str | None
    packet: int | None = None
    offset: int | None = None
    indexes: tuple[bool, ...] = ()
    presentation: dict[str, Any] | None = None
    sound: dict[str, Any] | None = None
    layers: int = 1
    profiles: tuple[str, ...] = ()


def by_the_plain_decoder(data: bytes, limits: dict[str, int]) -> Outcome:
    decoded = plain_decoder.decode(data, plain_container.Limits(**limits))
    frames = [make_vectors.hashes(state, decoded.header) for state in decoded.states]
    indexes = tuple(decoded.indexes)
    failure = decoded.failure
    if failure is None:
        heard = {"tracks": decoded.header.sound, "packets": make_vectors.heard_packets(decoded.sounds)}
        told = decoded.header
        return Outcome(frames, None, None, None, indexes, told.presentation, heard, told.layers, tuple(told.profiles))
    return Outcome(frames, failure.reason, failure.packet, failure.offset, indexes)


def by_the_product(data: bytes, limits: dict[str, int]) -> Outcome:
    """The product's layers in order: container, header, reconstruction."""
    header: StreamHeader | None = None
    states: list[State] = []
    told: list[Corrections] = []
    indexes: list[bool] = []
    container = {"max_payload": limits["payload_bytes"]} if "payload_bytes" in limits else {}
    population = {"max_gaussians": limits["gaussians"]} if "gaussians" in limits else {}
    sounds: list[list[Any]] = []
    failure: StreamError | None = None
    try:
        for packet in iterate_packets(io.BytesIO(data), **container):
            if packet.kind == PacketKind.HEADER:
                header = StreamHeader.from_bytes(packet.payload)
            elif packet.kind == PacketKind.INDEX:
                indexes.append(index_is_right(data, packet))
            elif packet.kind == PacketKind.SOUND:
                sounds += product_sound(packet, header) if packet.frame == len(states) - 1 else []
            elif packet.kind in FRAME_KINDS:
                before, first = (states[-1], states[0]) if states else (None, None)
                states.append(reconstruct(before, packet, header, first=first, **population))
                told.append(split_payload(packet, header.corrected)[0])
    except StreamError as error:
        failure = error
    frames = [product_hashes(state, header, found) for state, found in zip(states, told, strict=True)]
    if failure is None:
        heard = {"tracks": [track.as_document() for track in header.sound], "packets": sounds}
        shown = header.presentation.as_document()
        layers = max(1, len(header.layers))
        return Outcome(frames, None, None, None, tuple(indexes), shown, heard, layers, header.profiles)
    return Outcome(frames, failure.reason, failure.packet, failure.offset, tuple(indexes))


def index_is_right(data: bytes, packet: Packet) -> bool:
    try:
        return all(read_packet_at(io.BytesIO(data), entry) for entry in parse_index(packet))
    except StreamError:
        return False


def product_sound(packet: Packet, header: StreamHeader) -> list[list[Any]]:
    """As make_vectors.heard_packets."""
    try:
        found = read_sound(packet, header.sound)
    except StreamError:
        return []
    first = frame_start(packet.frame, header.fps) + found.offset
    return [[found.track, first, len(found.blocks), hashlib.sha256(b"".join(found.blocks)).hexdigest()]]


def product_hashes(state: State, header: StreamHeader, corrections: Corrections) -> dict[str, Any]:
    """As conformance/README.md defines them, from arrays."""
    told = {
        name: {field: getattr(found, field) for effect in header.corrected.of(name) for field in EFFECT_FIELDS[effect]}
        for name, found in corrections.items()
    }
    columns = [getattr(state, name).reshape(len(state), -1) for name in ARRAYS] if len(state) else []
    rows = b"".join(
        struct.pack("<Q", int(name)) + b"".join(np.asarray(column[row], "<i4").tobytes() for column in columns)
        for row, name in enumerate(state.ids)
    )
    splats = dequantise(state, header.lattice)
    shown = [getattr(splats, name).reshape(len(state), -1) for name in ARRAYS] if len(state) else []
    floats = np.concatenate(shown, axis=1, dtype="<f4").tobytes() if shown else b""
    return {
        **({"corrections": told} if told else {}),
        "gaussians": len(state),
        "digest": f"{digest(state):016x}",
        "integers": hashlib.sha256(struct.pack("<QI", state.next_id, len(state)) + rows).hexdigest(),
        "floats": hashlib.sha256(floats).hexdigest(),
    }


DECODERS = {"plain": by_the_plain_decoder, "product": by_the_product}
Decoder = Callable[[bytes, dict[str, int]], Outcome]
LARGE = {"good/gaps-of-three-bytes", "limits/zstd-single-segment-12-mib"}
"""Vectors that the plain decoder, lists of integers on purpose, takes ten seconds for."""


def by_both(names: list[str]) -> list[Any]:
    """Each decoder with each of the vectors."""
    return [
        pytest.param(
            decode, name, id=f"{who}-{name}", marks=[pytest.mark.slow] if who == "plain" and name in LARGE else []
        )
        for who, decode in DECODERS.items()
        for name in names
    ]


def check(outcome: Outcome, expected: dict[str, Any], data: bytes) -> None:
    failure = expected["failure"] or {"reason": None, "packet": None, "offset": None}
    assert outcome.reason == failure["reason"]
    assert outcome.packet == failure["packet"]
    assert outcome.frames == expected["frames"]
    assert outcome.indexes == tuple(expected.get("indexes", ()))
    if outcome.reason is None:
        assert outcome.presentation == expected.get("presentation", {})
        assert outcome.sound == expected.get("sound", {"tracks": [], "packets": []})
        assert outcome.layers == 1 + len(expected.get("layers", {"frames": []})["frames"])
        assert outcome.profiles == tuple(expected.get("profiles", ()))
    if failure["reason"] is not None:
        assert outcome.offset is not None
        # A reader may be more exact than the first byte of the packet (SPEC.md, section 9).
        assert failure["offset"] <= outcome.offset <= len(data)
        assert outcome.offset < end_of(data, failure)


def end_of(data: bytes, failure: dict[str, Any]) -> int:
    """Where the broken packet ends: offsets up to here are inside it."""
    if failure["packet"] is None:
        return 16
    head = data[failure["offset"] : failure["offset"] + 20]
    length = int.from_bytes(head[12:16], "little") if len(head) == 20 else 0
    return failure["offset"] + 24 + length


@pytest.mark.parametrize(("decode", "name"), by_both(sorted(EXPECTED)))
def test_a_vector_has_its_outcome(decode: Decoder, name: str) -> None:
    expected, data = EXPECTED[name], vector(name)
    check(decode(data, expected.get("limits", {})), expected, data)


@pytest.mark.parametrize("decode", DECODERS.values(), ids=DECODERS)
def test_large_vectors_have_their_outcomes(decode: Decoder) -> None:
    for large in limit_vectors.large_vectors():
        check(decode(large.data, {}), make_vectors.outcome(large), large.data)


@pytest.mark.parametrize("version", KEPT)
def test_the_archive_is_what_the_script_makes(version: str) -> None:
    made = make_vectors.files(version)
    assert sorted(KEPT[version]) == sorted(made)
    for name, data in KEPT[version].items():
        assert data == made[name], name
    assert make_vectors.path_of(version).read_bytes() == make_vectors.archive(version, made)


def test_the_suite_is_small_and_has_every_reason_code() -> None:
    assert len(EXPECTED) == sum(len(kept) - 2 for kept in KEPT.values()), "two vectors have the same name"
    assert all(make_vectors.path_of(version).stat().st_size < 1 << 20 for version in KEPT)
    assert {expected["failure"]["reason"] for expected in EXPECTED.values() if expected["failure"]} == ALL_REASONS


@pytest.mark.parametrize(("decode", "name"), by_both([name for name in GOOD if name.startswith("good/")]))
def test_a_stream_cut_after_a_packet_is_a_shorter_stream(decode: Decoder, name: str) -> None:
    data, frames = vector(name), 0
    for packet in iterate_packets(io.BytesIO(data)):
        frames += packet.kind in FRAME_KINDS
        grown = decode(data[: packet.offset + packet.size], {})
        assert (grown.reason, grown.frames) == (None, EXPECTED[name]["frames"][:frames])


@pytest.mark.parametrize("name", [name for name in sorted(EXPECTED) if "payload_bytes" not in str(EXPECTED[name])])
def test_an_opened_file_has_those_states_or_an_error(name: str, tmp_path: Path) -> None:
    """Through the index, where there is one: what it says wrong is an error, never another state."""
    expected, states = EXPECTED[name], []
    limits = expected.get("limits", {})
    population = {"max_gaussians": limits["gaussians"]} if "gaussians" in limits else {}
    reason = None
    try:
        with open_stream(vector_file(name, tmp_path), strict=True, layer="base", **population) as stream:
            states.extend(product_hashes(f.state, stream.header, f.corrections) for f in stream.frames())
    except StreamError as error:
        reason = error.reason
    assert states == expected["frames"][: len(states)]
    assert (reason is None) == (name in GOOD), reason
    if name in GOOD:
        assert len(states) == len(expected["frames"])


@pytest.mark.parametrize("name", [name for name in sorted(EXPECTED) if "limits" not in EXPECTED[name]])
def test_a_followed_stream_has_those_states_and_that_reason(name: str) -> None:
    """Followed strictly; limits are of memory and not of numbers."""
    expected, states, reason = EXPECTED[name], [], None
    try:
        with follow_stream(io.BytesIO(vector(name)), strict=True) as stream:
            states.extend(product_hashes(f.state, stream.header, f.corrections) for f in stream.frames())
    except StreamError as error:
        reason = error.reason
    assert states == expected["frames"]
    assert reason == (expected["failure"] and expected["failure"]["reason"])


def layers_by_the_plain_decoder(name: str, layer: int, folder: Path) -> tuple[list[dict[str, Any]], str | None]:
    """The hashes of each frame with this layer, and the reason with which that ends."""
    data, states = vector(name), []
    header = plain_decoder.decode(data, plain_container.Limits()).header
    try:
        states.extend(map(plain_layers.joined, plain_layers.decode_layers(data, layer)))
    except plain_container.Broken as broken:
        return [make_vectors.hashes(state, header) for state in states], broken.reason
    return [make_vectors.hashes(state, header) for state in states], None


def layers_by_the_product(name: str, layer: int, folder: Path) -> tuple[list[dict[str, Any]], str | None]:
    states: list[dict[str, Any]] = []
    try:
        with open_stream(vector_file(name, folder), strict=True, layer=layer) as stream:
            states.extend(product_hashes(frame.state, stream.header, {}) for frame in stream.frames())
    except StreamError as error:
        return states, error.reason
    return states, None


@pytest.mark.parametrize("name", LAYERED)
@pytest.mark.parametrize("decode", [layers_by_the_plain_decoder, layers_by_the_product], ids=["plain", "product"])
def test_layers_have_their_outcome(decode: Any, name: str, tmp_path: Path) -> None:
    expected = EXPECTED[name]["layers"]
    for layer, frames in enumerate(expected["frames"], start=1):
        assert decode(name, layer, tmp_path) == (frames, expected["failure"])


@pytest.mark.parametrize("name", [name for name in LAYERED if EXPECTED[name]["layers"]["failure"]])
def test_where_a_refinement_is_damaged_the_base_is_shown(name: str, tmp_path: Path) -> None:
    (whole,) = EXPECTED[name]["layers"]["frames"]
    found: list[Any] = []
    with open_stream(vector_file(name, tmp_path), on_damage=found.append) as stream:
        shown = [product_hashes(frame.state, stream.header, {}) for frame in stream.frames()]
    assert shown == whole + EXPECTED[name]["frames"][len(whole) :]
    assert [damage.error.reason for damage in found] == [EXPECTED[name]["layers"]["failure"]]


@pytest.mark.parametrize(
    "name",
    [name for name in GOOD if name.startswith(("good", "limits")) and "limits" not in EXPECTED[name] and name != HEARD],
)
def test_every_command_reads_a_good_vector(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """decogs-info, decogs-decode and decogs-export, strictly."""
    stream, frames = str(vector_file(name, tmp_path)), len(EXPECTED[name]["frames"])
    for shown in ([], ["--json"], ["--bytes"]):
        assert info_main([stream, "--strict", *shown]) == 0, capsys.readouterr().err
    facts = info(stream, strict=True)
    whole = EXPECTED[name].get("layers", {"frames": [EXPECTED[name]["frames"]]})["frames"][-1]
    assert [frame.gaussians for frame in facts.frames] == [frame["gaussians"] for frame in whole]
    assert all(sum(frame.bytes_by_purpose.values()) == frame.bytes - 24 for frame in facts.frames)
    if not frames:
        return
    view = facts.header.cameras[0]
    scale = str(min(1.0, 64 / max(view.width, view.height)))
    asked = ["--view", view.name, "--scale", scale, "--frames", "-3:", "--threads", "1"]
    assert decode_main([stream, "--strict", *asked, "-o", str(tmp_path / "o")]) == 0, capsys.readouterr().err
    assert len(list((tmp_path / "o").iterdir())) == min(3, frames)
    assert export_main([stream, "--strict", "-o", str(tmp_path / "o.usda")]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("seed", range(8))
def test_what_the_product_writes_the_plain_decoder_reads(seed: int) -> None:
    """Random scenes at every SH degree through the product's own choices: zstd, predictions, index sets, references."""
    rng = np.random.default_rng(seed)
    degree = seed % 4
    camera = Camera("a", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    header = StreamHeader(cameras=(camera,), lattice=default_lattice(4.0), sh_degree=degree)
    file = io.BytesIO()
    writer = StreamWriter(file, header.to_bytes())
    state, _ = keyframe_state(some_attributes(rng, 400, degree))
    first = state
    writer.write(PacketKind.KEY, 0, write_key(state).payload)
    for frame in range(1, 9):
        if frame == 4:
            writer.write(PacketKind.SKIP, frame, write_skip(state).payload)
            continue
        delta = some_delta(rng, state, degree)
        if frame == 7:
            state = apply_delta(state, delta)
            writer.write(PacketKind.KEY, frame, write_key(state, first=first, level=3).payload)
            continue
        writer.write(PacketKind.DELTA, frame, write_delta(state, delta, level=3 if frame % 2 else 19).payload)
        state = apply_delta(state, delta)
    writer.finish()
    product = by_the_product(file.getvalue(), {})
    assert product.reason is None
    assert len(product.frames) == 9
    assert product.frames[-1]["digest"] == f"{digest(state):016x}"
    assert by_the_plain_decoder(file.getvalue(), {}) == product


def test_what_the_encoder_makes_the_plain_decoder_reads(tmp_path: Path) -> None:
    """The sample rig, small and of few Gaussians; the third frame is a keyframe that refers to the first."""
    rig, path = Path(__file__).parents[1] / "demo" / "workbench", tmp_path / "encoded.dgs"
    live = PRESETS["live"]
    few = replace(live, keyframe=replace(live.keyframe, iterations=60, settle_iterations=30, cap=800))
    encode(rig, path, few, frames=slice(3), scale=0.1, segment=2)
    product = by_the_product(path.read_bytes(), {})
    assert (product.reason, len(product.frames), product.indexes) == (None, 3, (True,))
    assert by_the_plain_decoder(path.read_bytes(), {}) == product


def some_attributes(rng: np.random.Generator, count: int, degree: int) -> Attributes:
    def draw(*shape: int) -> np.ndarray:
        return rng.normal(0, 10 ** rng.uniform(0, 5), (count, *shape)).astype(np.int32)

    return Attributes(draw(3), draw(3), draw(4), draw(), draw((degree + 1) ** 2, 3))


def some_delta(rng: np.random.Generator, state: State, degree: int) -> Any:
    rows = np.sort(rng.permutation(len(state))[: rng.integers(0, len(state))])
    removed = np.sort(rng.permutation(len(state))[: rng.integers(0, 40)])
    current = some_attributes(rng, len(rows), degree)
    return difference(
        state, rows, current, removed=removed, added=some_attributes(rng, int(rng.integers(0, 60)), degree)
    )


@pytest.mark.parametrize(
    "name", ["good/worked-example", "good/keys-that-refer", "good/zstd-with-checksum", "good/corrections", "good/sound"]
)
@pytest.mark.parametrize("step", EVERY)
def test_both_decoders_agree_on_flipped_bytes(name: str, step: int) -> None:
    """Of packets behind the header; checksums are made right again, so that payloads break in their own ways."""
    data = vector(name)
    packets = list(iterate_packets(io.BytesIO(data)))
    step *= 1 if len(data) < 1500 else 7
    for packet in packets[1:]:
        for position in range(0, len(packet.payload), step):
            payload = bytearray(packet.payload)
            payload[position] ^= 1 << position % 8
            mended = stream_writer.packet(packet.kind, packet.frame, bytes(payload))
            broken = data[: packet.offset] + mended + data[packet.offset + packet.size :]
            plain, product = by_the_plain_decoder(broken, {}), by_the_product(broken, {})
            assert (plain.frames, plain.sound) == (product.frames, product.sound)
            assert (plain.reason, plain.packet) == (product.reason, product.packet), (packet.kind, position)
