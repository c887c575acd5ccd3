"""Hostile inputs and what must hold for each: valid streams to begin with, mutations of them, and the judge.

Mutations are of two kinds. Raw ones change bytes and leave checksums wrong. Structured ones change packets and
payloads, then repair lengths, checksums, index and, where the mutant can be reconstructed at all, the state's digest:
so they get past what stops the raw ones.
"""

from __future__ import annotations

import ctypes
import io
import struct
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from random import Random

import numpy as np
import zstandard

from decogs.codec.coding.entropy import BLOCK_HEADER_SIZE, coded_block
from decogs.codec.header.header import StreamHeader
from decogs.codec.header.presentation import Presentation
from decogs.codec.packets.corrections import CorrectedCameras, Correction, write_corrections
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.frame_payload import split_payload
from decogs.codec.packets.keyframes import keyframe_state, new_state
from decogs.codec.packets.sound import SoundTrack
from decogs.codec.packets.syntax import payload_costs, read_delta, read_key, write_delta, write_key, write_skip
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import default_lattice
from decogs.codec.scene.state import Attributes, State, all_rows, take_rows
from decogs.decoder.editing import (
    Box,
    Cameras,
    Clean,
    Concat,
    Crop,
    Grade,
    Merge,
    Operation,
    Retime,
    Set,
    Speed,
    Sphere,
    Strip,
    Transform,
    Trim,
    edit,
)
from decogs.decoder.reading.damage import Damage
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.sound.coding import coded
from decogs.decoder.sound.samples import mixed_sound
from decogs.formats.cameras import Camera
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import (
    FRAME_KINDS,
    MAX_FRAME,
    Packet,
    PacketKind,
    PacketReader,
    StreamWriter,
    prologue,
    read_index,
    scan_index,
)
from decogs.formats.stream.reasons import ALL_REASONS, Reason

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "conformance"))
import make_vectors

from packets import iterate_packets

MAX_MEMORY = 32 << 20
"""What inputs are opened with, in bytes."""

MAX_SECONDS = 1.0
"""Of processor time, which other programs on the machine do not lengthen."""

_SCENES = {*FRAME_KINDS, PacketKind.REFINE}
_PAYLOAD_KINDS = (PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP)
_DIGEST = struct.Struct("<Q")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_EDGES = (0, 1, 2, 3, 4, 5, 7, 8, 127, 128, 254, 255)
_WIDE_EDGES = (0, 1, 1 << 20, (1 << 27) - 1, 1 << 27, (1 << 28) + 1, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)
_LONG_EDGES = (0, (1 << 62) + 5, (1 << 63) - 1, 1 << 63, (1 << 64) - 1)


class Misbehaved(Exception):
    """An input made the library do what it must not."""


# --- valid streams ---------------------------------------------------------------------------------------------------


def seed_streams() -> list[bytes]:
    """Small valid streams that between them use every packet kind, id mode, index set and prediction mode."""
    return [
        _stream(count=3, sh_degree=0, finished=True),
        _stream(count=12, sh_degree=1, finished=True),
        _stream(count=12, sh_degree=0, finished=False),
        _stream(count=400, sh_degree=0, finished=True),
        _stream(count=0, sh_degree=0, finished=True),
        _stream(count=12, sh_degree=0, finished=True, corrected=_CORRECTED),
        _stream(count=3, sh_degree=0, finished=True, sound=True),
        *(make_vectors.kept("1.1")[f"good/{name}.dgs"] for name in ("two-layers", "three-layers")),
    ]


_CORRECTED = CorrectedCameras(exposure_drift=("a",), camera_shake=("a",))


def header(sh_degree: int, corrected: CorrectedCameras | None = None) -> StreamHeader:
    camera, corrected = Camera("a", 16, 12, 15.0, 15.0, 8.0, 6.0, np.eye(4)), corrected or CorrectedCameras()
    return StreamHeader(
        cameras=(camera,),
        lattice=default_lattice(4.0),
        sh_degree=sh_degree,
        effects=corrected.effects,
        corrected=corrected,
    )


def _shown_header() -> StreamHeader:
    placed = ((0.0, 0.0, 2.0, 1.0), (2.0, 0.0, 0.0, -3.0), (0.0, 2.0, 0.0, 0.5))
    return replace(header(0), presentation=Presentation("a title", 3, "a", placed))


def _sounding_header() -> StreamHeader:
    tracks = (SoundTrack(2, "a track", (1.0, -2.0, 3.0)), SoundTrack(1))
    return replace(header(0), fps=25.0, sound=tracks)


def _stream(
    *, count: int, sh_degree: int, finished: bool, corrected: CorrectedCameras | None = None, sound: bool = False
) -> bytes:
    file, described = io.BytesIO(), _sounding_header() if sound else header(sh_degree, corrected)
    tone = 0.5 * np.sin(np.arange(48_000, dtype=np.float32) / 20)
    sounds = [
        coded([np.tile(tone, (track.channels, 1))], track.channels, 25.0, track=number)
        for number, track in enumerate(described.sound)
    ]
    writer = StreamWriter(file, described.to_bytes())
    for packet in frame_packets(count, sh_degree):
        told = {"a": Correction(exposure=packet.frame - 3, yaw=900, roll=-packet.frame)}
        writer.write(packet.kind, packet.frame, write_corrections(told, described.corrected) + packet.payload)
        for heard in (one for coming in sounds for one in next(coming)):
            writer.write(PacketKind.SOUND, packet.frame, heard.payload())
        if packet.frame == 1:
            writer.write(PacketKind.METRICS, 1, b'{"psnr":30}')
            writer.write(99, 0, b"of a later version")
    if finished:
        writer.finish()
    return file.getvalue()


def frame_packets(count: int, sh_degree: int) -> Iterator[Packet]:
    """Keyframe, motion, nothing, births and deaths; a keyframe with listed ids, motion of everything, and a keyframe
    told against the first."""
    rng = np.random.default_rng(count)
    state, _ = keyframe_state(_scene(rng, count, sh_degree))
    first = state
    yield Packet(PacketKind.KEY, 0, write_key(state).payload)
    for frame in range(1, 7):
        if frame == 2:
            state = replace(state, frame=2)
            yield Packet(PacketKind.SKIP, 2, write_skip(state).payload)
        elif frame == 4:
            state = new_state(all_rows(state), 4, ids=state.ids, next_id=state.next_id + 9)
            yield Packet(PacketKind.KEY, 4, write_key(state).payload)
        elif frame == 6:
            state = replace(state, frame=6)
            yield Packet(PacketKind.KEY, 6, write_key(state, first=first).payload)
        else:
            rows = np.arange(len(state)) if frame == 5 else np.arange(0, len(state), 3)
            births = frame == 3
            delta = difference(
                state,
                rows,
                _nudged(rng, take_rows(state, rows)),
                removed=np.arange(0, len(state), 4) if births else None,
                added=_scene(rng, 5, sh_degree) if births else None,
            )
            yield Packet(PacketKind.DELTA, frame, write_delta(state, delta).payload)
            state = apply_delta(state, delta)


def _scene(rng: np.random.Generator, count: int, sh_degree: int) -> Attributes:
    shapes = ((3,), (3,), (4,), (), ((sh_degree + 1) ** 2, 3))
    return Attributes(*(rng.integers(-300, 300, (count, *shape)).astype(np.int32) for shape in shapes))


def _nudged(rng: np.random.Generator, attributes: Attributes) -> Attributes:
    steps = rng.integers(-40, 40, attributes.means.shape).astype(np.int32)
    return replace(attributes, means=attributes.means + steps, opacity_logits=attributes.opacity_logits + np.int32(1))


# --- mutations -------------------------------------------------------------------------------------------------------


def mutants(seeds: list[bytes], seed: int) -> Iterator[bytes]:
    """Endless mutants, the same for the same ``seed``: two structured ones for each raw one."""
    random = Random(seed)
    parsed = [list(iterate_packets(io.BytesIO(data))) for data in seeds]
    while True:
        choice = random.randrange(len(seeds))
        if random.random() < 1 / 3:
            yield mutated_bytes(random, seeds[choice])
        else:
            yield mutated_stream(random, parsed[choice])


def mutated_bytes(random: Random, data: bytes) -> bytes:
    """A few flips, edge values, insertions, deletions, repetitions; sometimes a cut."""
    mutant = bytearray(data)
    for _ in range(1 + min(random.getrandbits(3), random.getrandbits(3))):
        if not mutant:
            mutant.append(random.getrandbits(8))
        at = random.randrange(len(mutant))
        length = 1 + min(random.getrandbits(5), random.getrandbits(5))
        action = random.randrange(8)
        if action == 0:
            mutant[at] ^= 1 << random.randrange(8)
        elif action == 1:
            mutant[at] = random.choice(_EDGES)
        elif action == 2:
            mutant[at : at + 4] = struct.pack("<I", random.choice(_WIDE_EDGES))
        elif action == 3:
            mutant[at : at + 8] = struct.pack("<Q", random.choice(_LONG_EDGES))
        elif action == 4:
            del mutant[at : at + length]
        elif action == 5:
            mutant[at:at] = random.randbytes(length)
        elif action == 6:
            source = random.randrange(len(mutant))
            mutant[at:at] = mutant[source : source + length]
        elif random.random() < 0.25:
            del mutant[at:]
        else:
            mutant[at] = random.getrandbits(8)
    return bytes(mutant)


def mutated_stream(random: Random, packets: list[Packet]) -> bytes:
    """Packets changed, dropped, repeated or exchanged; then everything that protects them repaired."""
    chosen = [packet for packet in packets if packet.kind not in (PacketKind.INDEX, PacketKind.LAYERS, PacketKind.END)]
    for _ in range(1 + min(random.getrandbits(2), random.getrandbits(2))):
        at, action = random.randrange(len(chosen)), random.randrange(12)
        if random.random() < 0.8:
            at = random.choice([i for i, packet in enumerate(chosen) if packet.kind in _SCENES] or [at])
        packet = chosen[at]
        if action == 0 and len(chosen) > 1:
            del chosen[at]
        elif action == 1:
            chosen.insert(at, packet)
        elif action == 2:
            other = random.randrange(len(chosen))
            chosen[at], chosen[other] = chosen[other], packet
        elif action == 3:
            following = min(packet.frame + 1, MAX_FRAME)
            chosen[at] = replace(packet, frame=random.choice((0, 1, 3, 70_000, MAX_FRAME, following)))
        elif action == 4:
            kind = random.choice((1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 200))
            chosen[at] = replace(packet, kind=kind, critical=random.random() < 0.5)
        else:
            chosen[at] = replace(packet, payload=mutated_payload(random, packet.payload))
    return repaired_stream(chosen, finished=random.random() < 0.7)


def mutated_payload(random: Random, payload: bytes) -> bytes:
    """Bytes of a payload exchanged in their places, anything done to them, or what a compressed block holds changed."""
    choice = random.random()
    start = payload.find(_ZSTD_MAGIC, random.randrange(len(payload) or 1))
    if choice < 0.3 and start >= BLOCK_HEADER_SIZE:
        return _mutated_block(random, payload, start)
    return _exchanged(random, payload) if choice < 0.8 else mutated_bytes(random, payload)


def _exchanged(random: Random, data: bytes) -> bytes:
    """One to four bytes set to others; lengths and places stay."""
    mutant = bytearray(data)
    for _ in range(1 + min(random.getrandbits(2), random.getrandbits(2)) if data else 0):
        mutant[random.randrange(len(mutant))] = random.choice((*_EDGES, random.getrandbits(8)))
    return bytes(mutant)


def _mutated_block(random: Random, payload: bytes, start: int) -> bytes:
    """The compressed block whose data begins at ``start``, with other contents."""
    length = int.from_bytes(payload[start - 4 : start], "little")
    try:
        raw = zstandard.ZstdDecompressor().decompress(payload[start : start + length], max_output_size=1 << 20)
    except zstandard.ZstdError:
        return _exchanged(random, payload)
    raw = _exchanged(random, raw) if random.random() < 0.7 else mutated_bytes(random, raw)
    return payload[: start - BLOCK_HEADER_SIZE] + coded_block(raw, 1) + payload[start + length :]


def repaired_stream(packets: list[Packet], *, finished: bool) -> bytes:
    """The stream of these packets with right checksums, right digests where a state comes out, and a right index."""
    file = io.BytesIO(prologue())
    state: State | None = None
    first: State | None = None
    head = packets[0].payload if packets else b""
    try:
        described = StreamHeader.from_bytes(head)
    except StreamError:
        described = header(0)
    writer = StreamWriter(file, head)
    for packet in packets[1:]:
        if packet.kind in FRAME_KINDS:
            packet, state = repaired_frame(packet, state, described, first)
            first = state if first is None else first
        # A writer finds a refinement's layer in its first byte.
        payload = packet.payload or b"\0" if packet.kind == PacketKind.REFINE else packet.payload
        writer.write(packet.kind, packet.frame, payload, critical=packet.critical)
    if finished:
        writer.finish()
    return file.getvalue()


def repaired_frame(
    packet: Packet, state: State | None, described: StreamHeader, first: State | None
) -> tuple[Packet, State | None]:
    """The packet with the digest of the state it leads to, and that state; as it was where it leads to none."""
    options = {"max_gaussians": gaussians(described.coefficients)}
    try:
        return packet, reconstruct(state, packet, described, first=first, **options)
    except StreamError as error:
        if error.reason != Reason.DIGEST_MISMATCH:
            return packet, state
    _, packet = split_payload(packet, described.corrected)
    if packet.kind == PacketKind.KEY:
        after = read_key(packet, described.coefficients, first=first, **options)[0]
    elif packet.kind == PacketKind.DELTA:
        after = apply_delta(state, read_delta(packet, state, **options)[0])
    else:
        after = state
    before, behind = packet.payload[: packet.start], packet.payload[packet.start + _DIGEST.size :]
    mended = replace(packet, payload=before + _DIGEST.pack(digest(after)) + behind, start=0)
    return mended, reconstruct(state, mended, described, first=first, **options)


def gaussians(coefficients: int) -> int:
    """How many Gaussians payloads are tried with: enough to leave every loop's first turn, little enough to be fast."""
    return 20_000 // coefficients


# --- what is tried ---------------------------------------------------------------------------------------------------


def try_container(data: bytes) -> None:
    """Packets one after the other, past every damage, and the index both ways."""
    reader = PacketReader(io.BytesIO(data), max_payload=MAX_MEMORY)
    while _next_or_search(reader):
        pass
    for read in (read_index, scan_index):
        _refusable(lambda read=read: read(io.BytesIO(data)))


def _next_or_search(reader: PacketReader) -> bool:
    """Takes a packet, or moves past damage to one; whether there may be more."""
    try:
        return reader.next() is not None
    except StreamError as error:
        _check_reason(error)
        return error.reason != Reason.TOO_LARGE and reader.resynchronise() is not None


def try_header(data: bytes) -> None:
    """The header packet's payload; what is accepted must be writable, and come back as it was."""

    def read() -> None:
        described = StreamHeader.from_bytes(data)
        written = described.to_bytes()
        if StreamHeader.from_bytes(written).to_bytes() != written:
            raise Misbehaved("a header is not what was written")

    _refusable(read)


def try_payload(data: bytes) -> None:
    """A frame packet's payload on a state, behind one byte that chooses both; also with its digest repaired."""
    if not data:
        return
    choice = data[0]
    described, state, first = _payload_contexts()[choice & 1]
    kind = _PAYLOAD_KINDS[(choice >> 1) % 3]
    packet = Packet(kind, state.frame + 1, data[1:])
    limit = gaussians(described.coefficients)
    _refusable(lambda: reconstruct(state, packet, described, first=first, max_gaussians=limit))
    mended, after = repaired_frame(packet, state, described, first)
    base = first if kind == PacketKind.KEY else state
    if (
        after is not None
        and after is not state
        and sum(payload_costs(mended, described.coefficients, len(base)).values()) != len(mended.payload)
    ):
        raise Misbehaved("a payload's costs do not add up")


@dataclass
class FileTarget:
    """Whole streams: opened and followed, damage concealed and not, every frame reconstructed and accounted for."""

    path: Path

    def __call__(self, data: bytes) -> None:
        self.path.write_bytes(data)
        for strict in (False, True):
            _refusable(lambda strict=strict: self._open(strict))
            _refusable(lambda strict=strict: self._follow(data, strict))

    def _open(self, strict: bool) -> None:
        found: list[Damage] = []
        with open_stream(self.path, strict=strict, on_damage=found.append, max_memory=MAX_MEMORY) as stream:
            if _frames_read(stream.frames(), strict, found) != stream.frame_count:
                raise Misbehaved("frames are left out")
            if stream.header.sound:
                _hear(mixed_sound(stream, range(min(stream.frame_count, _FRAMES_HEARD))))

    def _follow(self, data: bytes, strict: bool) -> None:
        found: list[Damage] = []
        with follow_stream(io.BytesIO(data), strict=strict, on_damage=found.append, max_memory=MAX_MEMORY) as stream:
            sound = stream.heard() if stream.header.sound else iter(())
            _frames_read(stream.frames(), strict, found)
            _hear(islice(sound, _FRAMES_HEARD))


_FRAMES_HEARD = 20
"""Of a stream that may claim thousands of a second each, which only say silence."""


def _hear(pieces: Iterator[np.ndarray]) -> None:
    """Samples from -1 to 1."""
    for piece in pieces:
        if not (np.abs(piece) <= 1).all():
            raise Misbehaved("a stream sounds louder than it can")


EDITS: tuple[tuple[Operation, ...], ...] = (
    (Trim(slice(2, None)), Concat((Path(),))),
    (Crop(Sphere((0.0, 0.0, 0.0), 0.2), fade=0.1), Retime((Speed(0, None, 0.5, 2.0),), reverse=True)),
    (Transform(turns=(("X", 40.0),), scale=3.0), Merge(Path()), Set(title="x")),
    (Clean(size=0.5, seen=1), Grade(1.0, region=Box((-1.0, -1.0, -1.0), (0.1, 1.0, 1.0))), Strip(("rig", "sound"))),
    (Cameras(rename=(("a", "b"),)), Retime(holds=((3, 4),))),
    (Strip(("layers",)), Trim(slice(1, None))),
)
"""What is done to hostile streams; other streams are the stream itself."""


@dataclass
class EditTarget:
    """Whole streams: edited, or refused; what an edit has written is a stream without a fault."""

    path: Path

    def __call__(self, data: bytes) -> None:
        self.path.write_bytes(data)
        asked = EDITS[zlib.crc32(data) % len(EDITS)]
        try:
            report = edit(
                self.path, self.path.with_suffix(".out"), [self._of_this(each) for each in asked], max_memory=MAX_MEMORY
            )
        except (StreamError, UsageError):
            return
        with open_stream(self.path.with_suffix(".out"), strict=True) as stream:
            if sum(1 for _ in stream.frames()) != report.frame_count:
                raise Misbehaved("an edit lost frames")

    def _of_this(self, operation: Operation) -> Operation:
        if isinstance(operation, Concat):
            return Concat((self.path,))
        return Merge(self.path) if isinstance(operation, Merge) else operation


def _frames_read(frames: Iterator[DecodedFrame], strict: bool, found: list[Damage]) -> int:
    """How many there are; each has its place, and is what it says or told to be held."""
    index = -1
    for index, frame in enumerate(frames):
        if frame.index != index or (frame.concealed is not None and (strict or frame.concealed not in found)):
            raise Misbehaved(f"frame {index} is not what it says")
        if frame.concealed is None:
            _ = frame.splats, frame.costs, frame.changes
    return index + 1


def parsers() -> dict[str, tuple[Callable[[bytes], None], list[bytes]]]:
    """The parsers' targets by name, each with valid inputs to begin with."""
    payloads = [
        bytes([context | (_PAYLOAD_KINDS.index(packet.kind) << 1)]) + packet.payload
        for context in (0, 1)
        for packet in frame_packets(12, context)
    ]
    return {
        "container": (try_container, seed_streams()),
        "header": (
            try_header,
            [each.to_bytes() for each in (header(0), header(1, _CORRECTED), _shown_header(), _sounding_header())],
        ),
        "payload": (try_payload, payloads),
    }


def _payload_contexts() -> list[tuple[StreamHeader, State, State]]:
    if not _CONTEXTS:
        for sh_degree in (0, 1):
            described, state, first = header(sh_degree), None, None
            for packet in frame_packets(12, sh_degree):
                state = reconstruct(state, packet, described, first=first)
                first = state if first is None else first
            _CONTEXTS.append((described, state, first))
    return _CONTEXTS


_CONTEXTS: list[tuple[StreamHeader, State, State]] = []


def _refusable(action: Callable[[], object]) -> None:
    """What the input may do: nothing, or be refused with a reason and a place."""
    try:
        action()
    except StreamError as error:
        _check_reason(error)


def _check_reason(error: StreamError) -> None:
    if error.reason not in ALL_REASONS or f"[{error.reason}]" not in str(error):
        raise Misbehaved(f"an error without a reason: {error}")


# --- the judge -------------------------------------------------------------------------------------------------------


class Judge:
    """Tries inputs on a target and keeps what one took at most: seconds of processor time, bytes of memory.

    ``try_one`` raises Misbehaved for any exception that is not a StreamError (or is one without a known reason), for
    more than MAX_SECONDS, and when the process grows by more than MAX_MEMORY.
    """

    def __init__(self, target: Callable[[bytes], None]) -> None:
        self._target = target
        # What was freed before goes back: taken again, it would be no growth.
        ctypes.CDLL(None).malloc_trim(0)
        self.tried, self.slowest, self.memory = 0, 0.0, 0

    def figures(self) -> dict[str, float]:
        return {"inputs": self.tried, "slowest": self.slowest, "memory": self.memory}

    def try_one(self, data: bytes) -> None:
        before = _restart_peak()
        seconds = self._seconds(data)
        memory = _peak() - before
        if seconds > MAX_SECONDS:  # what an input takes, it takes every time; what the machine adds, it does not
            seconds = min(seconds, self._seconds(data), self._seconds(data))
        self.tried += 1
        self.slowest, self.memory = max(self.slowest, seconds), max(self.memory, memory)
        if seconds > MAX_SECONDS:
            raise Misbehaved(f"it took {seconds:.2f} s")
        if memory > MAX_MEMORY:
            raise Misbehaved(f"it took {memory >> 20} MiB")

    def _seconds(self, data: bytes) -> float:
        began = time.process_time()
        try:
            self._target(data)
        except Misbehaved:
            raise
        except Exception as error:
            raise Misbehaved(f"{type(error).__name__}: {error}") from error
        return time.process_time() - began


def _restart_peak() -> int:
    """Makes the process's memory of now, in bytes, its peak; Linux's "5" for clear_refs."""
    Path("/proc/self/clear_refs").write_text("5")
    return _peak()


def _peak() -> int:
    status = Path("/proc/self/status").read_bytes()
    return int(status[status.index(b"VmHWM:") + 6 :].split(maxsplit=1)[0]) << 10
