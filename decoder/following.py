"""A stream while it is still being written: its frames as their packets complete, from a growing file or a pipe.

The encoder writes ``NAME.part`` and renames it to ``NAME`` when it is whole; whoever follows names ``NAME`` and may
come before either is there. An encode that is killed and resumed is followed across that: the bytes it writes again are
the same ones.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import DEFAULT_MAX_GAUSSIANS, State
from decogs.formats.container import FRAME_KINDS, Packet, PacketKind, PacketReader, check_count, check_frame
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.reasons import Reason

from .session import DEFAULT_MAX_MEMORY, DecodedFrame, errors_name, gaussians_within, payload_within, read_header

DEFAULT_IDLE = 600.0
"""Seconds without anything new after which nothing more is expected; training a keyframe takes minutes."""

_POLL = 0.05


class GrowingStream:
    """A stream that may still grow. Build one with ``follow_stream``.

    ``header`` is there from the beginning; ``ended`` tells whether the end packet has come.
    """

    def __init__(self, file: BinaryIO, name: str, *, idle: float | None, max_memory: int) -> None:
        self._file, self.name, self._idle = file, name, idle
        self._reader = PacketReader(file, max_payload=payload_within(max_memory))
        with errors_name(name):
            self.header = read_header(self._next(), self._reader.offset)
        self._max_gaussians = gaussians_within(max_memory, self.header.coefficients, DEFAULT_MAX_GAUSSIANS)

    @property
    def ended(self) -> bool:
        return self._reader.ended

    def frames(self) -> Iterator[DecodedFrame]:
        """The frames from the first on, each when it has come; ends with the stream, or when nothing more comes.

        Every frame's checksums and state digest are verified. Raises StreamError at damage.
        """
        frame: DecodedFrame | None = None
        first: State | None = None
        while True:
            with errors_name(self.name):
                packet = self._next()
                if packet is None:
                    return
                if packet.kind == PacketKind.END:
                    check_count(packet, 0 if frame is None else frame.index + 1)
                if packet.kind not in FRAME_KINDS:
                    continue
                before = None if frame is None else frame.state
                check_frame(packet, 0 if before is None else before.frame + 1)
                state = reconstruct(before, packet, self.header, first=first, max_gaussians=self._max_gaussians)
                first = state if first is None else first
                frame = DecodedFrame(packet, state, self.header, frame, first)
            yield frame

    def _next(self) -> Packet | None:
        """The next packet, waited for; None after the end packet, at a pipe's end and when nothing more comes."""
        seen, since = self._reader.pending, time.monotonic()
        while (packet := self._reader.next()) is None:
            if self.ended or self._idle is None:
                return None
            self._check_not_cut()
            if self._reader.pending != seen:
                seen, since = self._reader.pending, time.monotonic()
            if time.monotonic() - since >= self._idle:
                return None
            time.sleep(_POLL)
        return packet

    def _check_not_cut(self) -> None:
        """A file that was begun anew has lost what was read of it."""
        place = self._reader.offset + self._reader.pending
        if os.fstat(self._file.fileno()).st_size < place:
            raise StreamError(Reason.TRUNCATED, "the file was cut back meanwhile; follow it again", offset=place)


@contextmanager
def follow_stream(
    stream: str | os.PathLike[str] | BinaryIO,
    *,
    idle: float = DEFAULT_IDLE,
    max_memory: int = DEFAULT_MAX_MEMORY,
) -> Iterator[GrowingStream]:
    """Follows the stream that the encoder writes as ``stream``, or reads one from a pipe until that ends.

    ``max_memory``: as in ``open_stream``. Damage is an error.

    Waits up to ``idle`` seconds for the file, for its header, and for each further packet. A file is looked for as
    ``stream`` + ".part" first. Raises UsageError when there is none, StreamError for what is no readable stream.
    """
    if not idle > 0:
        raise UsageError(f"{idle:g} s are no time to wait; give a number of seconds above 0")
    if not isinstance(stream, (str, os.PathLike)):
        yield GrowingStream(stream, "-", idle=None, max_memory=max_memory)
        return
    with _opened(Path(stream), idle) as file:
        yield GrowingStream(file, str(stream), idle=idle, max_memory=max_memory)


def _opened(path: Path, idle: float) -> BinaryIO:
    """The file when it is there, unbuffered, so that what was its end is looked at again."""
    since = time.monotonic()
    candidates = (path.with_name(path.name + ".part"), path)
    while True:
        # One that is renamed between the two looks is found the next time.
        with suppress(FileNotFoundError):
            return open(next((c for c in candidates if c.exists()), path), "rb", buffering=0)
        if time.monotonic() - since >= idle:
            raise UsageError(
                f"{path}: neither it nor {path.name}.part is there after {idle:g} s; is the encoder running?"
            )
        time.sleep(_POLL)
