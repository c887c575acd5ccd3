"""Parts joined to the stream that an encode in one go would have written: what ``decogs-join`` does."""

from __future__ import annotations

import hashlib
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import STREAM, Output, check_outputs
from decogs.formats.files.regular_files import open_regular
from decogs.formats.frames.ranges import frames_text
from decogs.formats.stream.container import FRAME_KINDS, Packet, PacketKind, PacketReader, check_count, check_frame
from decogs.formats.system.callbacks import OnProgress

from ..output.resume import difference_of, difference_of_headers
from ..output.stream_output import open_output
from .manifest import Part, read_part, without_part


@dataclass(frozen=True)
class JoinReport:
    """What was joined: parts, frames, and the bytes of the stream."""

    parts: int
    frames: int
    total_bytes: int


@dataclass(frozen=True)
class _File:
    """A whole part: its manifest, the whole stream's header, digests of its first keyframe's payload and of it all."""

    path: Path
    part: Part
    header: bytes
    keyframe: str
    content: str


def join(
    parts: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str] | BinaryIO,
    *,
    resume: bool = False,
    on_frame: OnProgress | None = None,
) -> JoinReport:
    """Joins the ``parts`` of one take, in any order, to the stream ``output``.

    Every part is read twice, a packet at a time: it is checked as a whole before anything is written, and must be the
    same when it is. A part of the first keyframe alone may be among them. ``resume``: what a join of these parts that
    was cut off left in ``output`` + ".part" is replaced.
    Raises UsageError, which names the part, for one that is damaged, of another encode, there twice or no file, and
    for frames that no part has.
    """
    paths = [Path(path) for path in parts]
    stream = Path(output) if isinstance(output, (str, os.PathLike)) else output
    output_file = Output("output", stream, grows=True, format=STREAM)
    check_outputs([output_file], [(path, "is read, as one of the parts") for path in paths])
    files = _in_order([_check_part(path) for path in paths])
    header, total = files[0].header, len(files[0].part.take)

    def begins_alike(left: StreamHeader, frames: int) -> bool:
        return left.to_bytes() == header and frames <= total

    with open_output(stream, resumable=False, expendable=begins_alike if resume else None) as target:
        target.begin(header)
        done, whole = 0, False
        try:
            for file in files:
                for packet in _own(file):
                    target.write(packet.kind, file.part.frame_in_stream(packet.frame), packet.payload)
                    if packet.kind in FRAME_KINDS:
                        done += 1
                        if on_frame is not None:
                            on_frame(done, total)
            whole = True
        finally:
            target.close(done if whole else 0)
        return JoinReport(len(files), done, target.publish())


def _own(file: _File) -> Iterator[Packet]:
    """The part's own frames, their sound and metrics; the first keyframe is one of the part that begins with it.

    Raises UsageError at the end if the part is not the one that was checked.
    """
    kinds = FRAME_KINDS | {PacketKind.SOUND} | ({PacketKind.METRICS} if file.part.metrics else set())
    content = hashlib.sha256()
    for packet in _packets(file.path, content):
        if packet.kind in kinds and (packet.frame or not file.part.start):
            yield packet
    if content.hexdigest() != file.content:
        raise UsageError(f"{file.path}: the part was changed while it was joined; leave it alone, and join again")


def _check_part(path: Path) -> _File:
    """The part at ``path``, every packet of which was read and is intact."""
    header, keyframe, frames, ended, content = None, "", 0, False, hashlib.sha256()
    for packet in _packets(path, content):
        if packet.kind == PacketKind.HEADER:
            header = _read_header(path, packet.payload)
        elif packet.kind in FRAME_KINDS:
            _check_packet(path, check_frame, packet, frames)
            if not frames:
                keyframe = hashlib.sha256(packet.payload).hexdigest()
            frames += 1
            _check_start(path, packet, header)
        elif packet.kind in (PacketKind.METRICS, PacketKind.SOUND):
            _check_packet(path, check_frame, packet, frames - 1)
        elif packet.kind == PacketKind.END:
            _check_packet(path, check_count, packet, frames)
            ended = True
    part = None if header is None else read_part(header)
    if header is None or part is None:
        raise UsageError(f"{path}: this is no part of a take; give files that `only` has made")
    if not ended or frames != part.packets:
        _refuse_damaged(path, f"{frames} of its {part.packets} frame packets are there")
    return _File(path, part, without_part(header).to_bytes(), keyframe, content.hexdigest())


def _check_start(path: Path, packet: Packet, header: StreamHeader | None) -> None:
    """A part's own first frame is a keyframe, so that what comes before it does not matter."""
    part = None if header is None else read_part(header)
    if part is not None and packet.frame == min(1, part.start) and packet.kind != PacketKind.KEY:
        _refuse_damaged(path, "it does not begin with a keyframe")


def _read_header(path: Path, payload: bytes) -> StreamHeader:
    try:
        return StreamHeader.from_bytes(payload)
    except StreamError as error:
        _refuse_damaged(path, str(error))


def _packets(path: Path, content: hashlib._Hash) -> Iterator[Packet]:
    """The packets of a part, each of which goes into the digest ``content``."""
    try:
        with open_regular(path) as file:
            reader = PacketReader(file)
            while (packet := reader.next()) is not None:
                content.update(struct.pack("<III", packet.kind, packet.frame, len(packet.payload)) + packet.payload)
                yield packet
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; give the file of a part, which is read twice") from None
    except StreamError as error:
        _refuse_damaged(path, str(error))


def _check_packet(path: Path, check: Callable[[Packet, int], None], packet: Packet, frames: int) -> None:
    try:
        check(packet, frames)
    except StreamError as error:
        _refuse_damaged(path, str(error))


def _refuse_damaged(path: Path, problem: str) -> NoReturn:
    raise UsageError(f"{path}: the part is damaged ({problem}); encode it again")


def _in_order(files: Sequence[_File]) -> list[_File]:
    """The parts in the order of their frames, which are all there and none twice."""
    if not files:
        raise UsageError("`parts`: give at least one part")
    for file in files[1:]:
        _check_same(file, files[0])
    take = files[0].part.take
    # The first keyframe is in every part. A part of it alone is only needed where segments have a single frame.
    needed = len(take) == 1 or any(file.part.start == 1 for file in files)
    own = [file for file in files if needed or file.part.packets > 1]
    ordered = sorted(own, key=lambda file: file.part.frames.start)
    at = take.start
    for before, file in zip([None, *ordered], ordered, strict=False):
        frames = file.part.frames
        if before is not None and frames.start < at:
            doubled = range(frames.start, min(at, frames.stop))
            raise UsageError(
                f"{file.path}: it has {frames_text(doubled)}, which {before.path} has as well; leave out one of the two"
            )
        if frames.start > at:
            _refuse_gap(range(at, frames.start))
        at = frames.stop
    if at < take.stop:
        _refuse_gap(range(at, take.stop))
    return ordered


def _refuse_gap(frames: range) -> NoReturn:
    only = f"`only` {frames.start}:{frames.stop}"
    raise UsageError(f"`parts`: none of them has {frames_text(frames)}; encode a part with {only}")


def _check_same(file: _File, first: _File) -> None:
    """Raises UsageError unless both are parts of one encode."""
    problem = file.part.difference(first.part)
    if not problem:
        mine, others = (StreamHeader.from_bytes(each.header).settings for each in (file, first))
        problem = difference_of(mine, others, "the other part has")
    if not problem and file.keyframe != first.keyframe:
        problem = "it starts from another first keyframe"
    if not problem:
        problem = difference_of_headers(file.header, first.header, "the other part has")
    if problem:
        raise UsageError(
            f"{file.path}: it does not belong to {first.path}: {problem}; leave it out, or encode it again"
        )
