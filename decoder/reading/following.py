"""A stream while it is still being written: its frames as their packets complete, from a growing file or a pipe.

The encoder writes ``NAME.part`` and renames it to ``NAME`` when it is whole; whoever follows names ``NAME`` and may
come before either is there. An encode that is killed and resumed is followed across that: the bytes it writes again are
the same ones. Damage is concealed as in a file that is opened, but reported without knowing where the next keyframe is.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, TypeVar

from decogs.codec.packets.frame_payload import split_payload
from decogs.codec.packets.sound import MAX_PACKETS, read_sound
from decogs.codec.scene.state import DEFAULT_MAX_GAUSSIANS, State
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import is_left_over, part_of
from decogs.formats.files.regular_files import open_regular
from decogs.formats.stream.container import (
    FRAME_KINDS,
    MAX_PAYLOAD,
    Packet,
    PacketKind,
    PacketReader,
    check_count,
    check_frame,
    end_fields,
    stops_inside,
)
from decogs.formats.stream.reasons import Reason
from decogs.formats.stream.survey import check_damage_count, check_lost, next_past_damage, past_unfinished

from ..limits import DEFAULT_MAX_MEMORY, gaussians_within, limits_explained, payload_within
from ..sound.following import GrowingSound
from .damage import Concealment, Damage, OnDamage, errors_name
from .frame import DecodedFrame, decode_frame
from .stream import in_its_world, read_header

DEFAULT_IDLE = 600.0
"""Seconds without anything new after which nothing more is expected; training a keyframe takes minutes."""

_POLL = 0.05

_BUILDING_ON = frozenset({PacketKind.DELTA, PacketKind.SKIP})
"""What only says how a frame differs from the one before."""

_Awaited = TypeVar("_Awaited")


class GrowingStream:
    """A stream that may still grow. Build one with ``follow_stream``.

    ``header`` is there from the beginning; ``ended``: whether the end packet has come, ``frame_count`` how many
    frames have, those included that are lost, and ``unfinished_bytes`` how much of a packet at the tail when no more
    comes.
    """

    def __init__(
        self,
        file: BinaryIO,
        name: str,
        *,
        idle: float | None,
        strict: bool,
        on_damage: OnDamage | None,
        max_memory: int,
    ) -> None:
        self._file, self.name, self._idle = file, name, idle
        self._concealment = Concealment(name, strict=strict, on_damage=on_damage)
        self._damaged_places = self._lost_frames = self.frame_count = self.unfinished_bytes = 0
        max_payload = payload_within(max_memory)
        self._reader = PacketReader(file, max_payload=max_payload)
        self._max_memory, self._limits = max_memory, {max_payload} - {MAX_PAYLOAD}
        with self._errors_named():
            self.header = in_its_world(read_header(self._awaited(self._reader.next), self._reader.offset))
        self._max_gaussians = gaussians_within(max_memory, self.header.coefficients, DEFAULT_MAX_GAUSSIANS)
        self._limits |= {self._max_gaussians} - {DEFAULT_MAX_GAUSSIANS}
        self._first: State | None = None
        self._sound: GrowingSound | None = None
        self._is_over = False

    @property
    def ended(self) -> bool:
        """Whether the end packet has been read."""
        return self._reader.ended

    def heard(self, first: int = 0) -> GrowingSound:
        """What is heard in the frames from ``first`` on, as far as they are over; the stream has sound.

        Asked for before `frames`, which brings it.
        """
        assert self.header.fps is not None
        frames_over = lambda: self.frame_count if self._is_over else self.frame_count - 1  # noqa: E731
        self._sound = GrowingSound(self.header.sound, self.header.fps, first, frames_over)
        return self._sound

    def frames(self) -> Iterator[DecodedFrame]:
        """The frames from the first on, each when it has come; ends with the stream, or when nothing more comes.

        Every frame's checksums and state digest are verified. A frame that is damaged, and those after it up to the
        next keyframe, are the last good frame once more, ``concealed``; when there is none, or the stream is followed
        strictly, damage raises StreamError. How many frames a damaged place has cost only the next intact packet of a
        frame shows, or the end packet: these frames come, and the place is reported, together with that.
        """
        shown: DecodedFrame | None = None
        with self._errors_named():
            while True:
                self._check_open()
                packet, errors = self._next_intact(0 if shown is None else shown.index + 1)
                for held in self._lost_before(packet, shown, errors):
                    shown, self.frame_count = held, held.index + 1
                    yield held
                self._is_over = packet is None or packet.kind == PacketKind.END
                if packet is None:
                    return
                if packet.kind in FRAME_KINDS:
                    shown = self._shown(packet, shown)
                    self.frame_count = shown.index + 1
                    yield shown

    def _next_intact(self, expected: int) -> tuple[Packet | None, list[StreamError]]:
        """The next packet of a frame not before ``expected``, or the end packet, and the damage on the way there.

        None when nothing more comes.
        """
        errors: list[StreamError] = []
        sounds = 0
        while (item := self._next()) is not None:
            if isinstance(item, StreamError):
                errors.append(self._accepted(item))
                if self.ended:
                    break
            elif item.kind == PacketKind.SOUND:
                sounds += item.frame == expected - 1
                if self._sound is not None and item.frame == expected - 1 and sounds <= MAX_PACKETS:
                    self._hear(item, self._sound, errors)
            elif item.kind in FRAME_KINDS or item.kind == PacketKind.END:
                repeated = item.kind in FRAME_KINDS and item.frame < expected
                disorder = _disorder(item, expected)
                # Frames that are missing where there is damage are no second fault.
                if disorder is not None and (repeated or not errors):
                    errors.append(self._accepted(disorder))
                if not repeated:
                    return item, errors
        return None, errors

    def _hear(self, packet: Packet, sound: GrowingSound, errors: list[StreamError]) -> None:
        try:
            sound.take(packet.frame, read_sound(packet, self.header.sound))
        except StreamError as error:
            errors.append(self._accepted(error))

    def _lost_before(
        self, packet: Packet | None, before: DecodedFrame | None, errors: list[StreamError]
    ) -> Iterator[DecodedFrame]:
        """The frames between the last one shown and the one ``packet`` implies, held; says what was damaged there."""
        expected = 0 if before is None else before.index + 1
        lost = range(expected, expected if packet is None else _frames_declared(packet))
        if before is None and errors and (lost or packet is None):
            raise errors[0]
        self._lost_frames += len(lost)
        check_lost(self._lost_frames, lost.stop - self._lost_frames)
        if before is None or not lost:
            for error in errors:
                self._concealment.report(Damage(error))
            return
        onward = packet is not None and packet.kind in _BUILDING_ON
        damages = [Damage(error, lost, before.shows, onward) for error in errors]
        for damage in damages:
            self._concealment.report(damage)
        for index in lost:
            yield before.held(index, damages[0])

    def _shown(self, packet: Packet, before: DecodedFrame | None) -> DecodedFrame:
        """A packet's frame, or the last good one when it is damaged or builds on what is lost."""
        if before is not None and before.concealed is not None and packet.kind != PacketKind.KEY:
            return before.held(packet.frame, before.concealed)
        try:
            return self._decoded(packet, before)
        except StreamError as error:
            if before is None:
                raise
            lost = range(packet.frame, packet.frame + 1)
            damage = Damage(self._accepted(error), lost, before.shows, onward=True)
            self._concealment.report(damage)
            return before.held(packet.frame, damage)

    def _decoded(self, packet: Packet, before: DecodedFrame | None) -> DecodedFrame:
        payload = split_payload(packet, self.header.corrected)
        frame = decode_frame(payload, before, self.header, first=self._first, max_gaussians=self._max_gaussians)
        self._first = frame.state if self._first is None else self._first
        return frame

    def _accepted(self, error: StreamError) -> StreamError:
        """Damage that is concealed; raises it, or that there is too much of it, when it is not."""
        if not self._concealment.allows(error):
            raise error
        self._damaged_places += 1
        check_damage_count(self._damaged_places, error)
        return error

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        with errors_name(self.name), limits_explained(self._max_memory, self._limits):
            yield

    def _check_open(self) -> None:
        if self._file.closed:
            raise UsageError(f"{self.name}: the stream is closed; read its frames while it is open")

    def _next(self) -> Packet | StreamError | None:
        """The next packet or damage, waited for; None after the end packet, and when nothing more comes."""
        item = self._awaited(self._look)
        if item is not None:
            return item
        if self._concealment.strict and self._reader.pending:
            raise stops_inside(self._reader.pending, self._reader.offset, self._reader.ordinal)
        self.unfinished_bytes = self._reader.pending
        return past_unfinished(self._reader)

    def _look(self) -> Packet | StreamError | None:
        return next_past_damage(self._reader, self._concealment.allows)

    def _awaited(self, look: Callable[[], _Awaited]) -> _Awaited:
        """What ``look`` finds, waited for; None after the end packet, at a pipe's end and when nothing more comes."""
        read, since = self._reader.bytes_read, time.monotonic()
        while (result := look()) is None:
            if self.ended or self._idle is None:
                return result
            self._check_not_cut()
            if self._reader.bytes_read != read:
                read, since = self._reader.bytes_read, time.monotonic()
            if time.monotonic() - since >= self._idle:
                return result
            time.sleep(_POLL)
        return result

    def _check_not_cut(self) -> None:
        """A file that was begun anew has lost what was read of it."""
        read = self._reader.bytes_read
        if os.fstat(self._file.fileno()).st_size < read:
            raise StreamError(Reason.TRUNCATED, "the file was cut back meanwhile; follow it again", offset=read)


def _frames_declared(packet: Packet) -> int:
    """How many frames there were before this packet of a frame, or the end packet, by its own account."""
    return packet.frame if packet.kind in FRAME_KINDS else end_fields(packet)[0]


def _disorder(packet: Packet, expected: int) -> StreamError | None:
    """What is wrong when the packet of a frame, or the end packet, comes where ``expected`` frames came before it."""
    try:
        (check_frame if packet.kind in FRAME_KINDS else check_count)(packet, expected)
    except StreamError as error:
        return error
    return None


@contextmanager
def follow_stream(
    stream: str | os.PathLike[str] | BinaryIO,
    *,
    idle: float = DEFAULT_IDLE,
    strict: bool = False,
    on_damage: OnDamage | None = None,
    max_memory: int = DEFAULT_MAX_MEMORY,
) -> Iterator[GrowingStream]:
    """Follows the stream that the encoder writes as ``stream``, or reads one from a pipe until that ends.

    ``strict``, ``on_damage`` and ``max_memory`` are those of ``open_stream``. A damaged header or first keyframe is an
    error in any case, and so is a file that is cut back meanwhile.

    Waits up to ``idle`` seconds for the file, for its header, and for each further packet. A file is looked for as
    ``stream`` + ".part" first, unless that is what an encode killed in its first frame left beside a whole file.
    Raises UsageError when there is none, StreamError for what is no readable stream.
    """
    if not idle > 0:
        raise UsageError(f"{idle:g} s are no time to wait; give a number of seconds above 0")
    if not isinstance(stream, (str, os.PathLike)):
        yield GrowingStream(stream, "-", idle=None, strict=strict, on_damage=on_damage, max_memory=max_memory)
        return
    with _opened(Path(stream), idle) as file:
        yield GrowingStream(file, str(stream), idle=idle, strict=strict, on_damage=on_damage, max_memory=max_memory)


def followed(stream: str | os.PathLike[str]) -> Path:
    """The name that a growing stream will have when it is whole, given that or ``NAME.part``."""
    path = Path(stream)
    return path.with_suffix("") if path.suffix == ".part" else path


def open_growing(path: Path) -> BinaryIO:
    """The file that an encoder writes as ``path``, as far as it is: ``NAME.part`` while it grows, then ``NAME``.

    Unbuffered, so that what was its end is looked at again. Raises FileNotFoundError when neither is there; one that is
    renamed between the two looks is found the next time.
    """
    growing = part_of(path)
    left_over = path.exists() and is_left_over(growing)
    return open_regular(growing if growing.exists() and not left_over else path, buffering=0)


def _opened(path: Path, idle: float) -> BinaryIO:
    """The file when it is there."""
    since = time.monotonic()
    while True:
        with suppress(FileNotFoundError):
            return open_growing(path)
        if time.monotonic() - since >= idle:
            raise UsageError(
                f"{path}: neither it nor {part_of(path).name} is there after {idle:g} s; is the encoder running?"
            )
        time.sleep(_POLL)
