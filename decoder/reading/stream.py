"""A .dgs stream, opened: its header, and any range of its frames."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, cast

from decogs.codec.header.header import StreamHeader, unknown_members
from decogs.codec.layers import FirstKeyframe
from decogs.codec.packets.frame_payload import FramePayload, split_payload
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.state import DEFAULT_MAX_GAUSSIANS, State
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.regular_files import Unchanged, open_regular
from decogs.formats.geometry.similarity import transformed_camera
from decogs.formats.stream.container import (
    MAX_PAYLOAD,
    Packet,
    PacketKind,
    PacketReader,
    check_count,
    end_fields,
    end_of_packet,
    read_index,
    scan_index,
    stops_inside,
    unknown_kinds,
)
from decogs.formats.stream.reasons import Reason
from decogs.formats.stream.survey import Survey, search, survey

from ..limits import DEFAULT_MAX_MEMORY, frames_within, gaussians_within, limits_explained, payload_within
from ..sound.packets import FrameSound, sound_behind
from .damage import Concealment, Damage, OnDamage, errors_name
from .frame import DecodedFrame, decode_frame, layered_frame
from .packets import WRONG_INDEX, FileFrom, FramePackets
from .refining import Refiner, layer_number, lost_refinement


class Stream:
    """An open .dgs file; a context manager. Build one with ``open_stream``.

    ``header`` is the stream's header, its cameras where they are shown (SPEC.md, "Presentation"), ``stored_header`` the
    same as it is written; ``version`` (major, minor) its bitstream's; ``complete``: whether the stream
    was finished, ``unfinished_bytes`` how much of an incomplete packet lies at its tail. Iterators of ``frames`` are
    independent of each other.
    """

    def __init__(
        self,
        path: Path,
        *,
        strict: bool,
        on_damage: OnDamage | None,
        max_gaussians: int,
        max_memory: int,
        layer: str | int | None,
    ) -> None:
        self.path = path
        self._concealment = Concealment(path, strict=strict, on_damage=on_damage)
        self._file = _opened(path)
        self._unchanged = Unchanged(self._file, path)
        self._max_memory, self._max_payload = max_memory, payload_within(max_memory)
        self._max_frames = frames_within(max_memory)
        self._limits = {self._max_payload, self._max_frames} - {MAX_PAYLOAD}
        with self._closed_on_error(), self._errors_named():
            reader = self._reader(0)
            self.stored_header = read_header(reader.next(), reader.offset)
            self.header = in_its_world(self.stored_header)
            self.version = reader.version
            self._survey = self._surveyed()
            self._scanned: Survey | None = None
            self.complete, self.unfinished_bytes = self._survey.complete, self._survey.unfinished_bytes
            self._unchanged.grows = not self.complete
            if strict and self.unfinished_bytes:
                raise stops_inside(self.unfinished_bytes, self.file_bytes - self.unfinished_bytes)
            self._max_gaussians = gaussians_within(max_memory, self.header.coefficients, max_gaussians)
            self._limits |= {self._max_gaussians} - {max_gaussians}
            self._first: State | None = None
            top = layer_number(layer, self.header)
            self._refiner = Refiner(self._file, self.header, top, lambda: self._survey, max_payload=self._max_payload)
            self._first_layers: FirstKeyframe | None = None
        for error in self._survey.harmless():
            self._concealment.report(Damage(error))

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    @property
    def frame_count(self) -> int:
        """Frames whose packets are complete, and those that are known to be lost."""
        return self._survey.frame_count

    @property
    def keyframes(self) -> tuple[int, ...]:
        """The frames at which segments begin, as far as they are not lost."""
        return tuple(entry.frame for entry in self._survey.entries if entry.kind == PacketKind.KEY)

    @property
    def file_bytes(self) -> int:
        """Bytes of the file as it is on disk."""
        return os.fstat(self._file.fileno()).st_size

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[DecodedFrame]:
        """The frames from ``start`` up to, not including, ``stop`` (the stream's end when None), in order.

        Reading begins at the last keyframe at or before ``start``; the stream's first one is read, too, where that one
        refers to it. Every frame's checksums and state digest are verified. A frame that is damaged, and those after it
        up to the next keyframe, are the last good frame once more, ``concealed``; when there is none, or the stream was
        opened strictly, damage raises StreamError. Raises UsageError when the range is not one of this stream, and once
        the stream is closed.
        """
        self._check_open()
        stop = self.frame_count if stop is None else stop
        if not 0 <= start <= stop <= self.frame_count:
            raise UsageError(f"{self.path}: frames {start}:{stop} are not in this stream of {self.frame_count} frames")
        if start == stop:
            return
        with self._errors_named():
            packets = self._packets()
            frame = self._opening(start, packets)
        while True:
            if frame.index >= start:
                yield frame
            if frame.index + 1 == stop:
                return
            self._check_open()
            with self._errors_named():
                frame = self._following(frame, packets)

    def sounds(self, start: int = 0, stop: int | None = None) -> Iterator[FrameSound]:
        """The sound of each frame from ``start`` up to ``stop``; nothing else is read. Damaged packets are left out.

        A frame's sound is right after those before it (`decoder.sound.samples.frames_before`). Raises as `frames`.
        """
        self._check_open()
        stop = self.frame_count if stop is None else stop
        if not self.header.sound:
            yield from repeat((), stop - start)
            return
        for frame in range(start, stop):
            with self._errors_named():
                sound = self._sound_of(frame)
            yield sound

    def unknown_parts(self) -> list[str]:
        """What the file holds that this version does not know: members of its header, kinds of packets."""
        with self._errors_named():
            header = self._reader(0).next()
            members = [] if header is None else unknown_members(header.payload)
            kinds = unknown_kinds(self._file)
        return [*members, *(f"packets of kind {kind}" for kind in kinds)]

    def _sound_of(self, frame: int) -> FrameSound:
        entry, after = self._survey.entry(frame), self._survey.entry(frame + 1)
        if entry is None:
            return ()
        try:
            reader = self._reader(end_of_packet(self._file, entry.offset))
        except StreamError as error:
            self._pass_over(error)
            return ()
        return sound_behind(frame, reader, None if after is None else after.offset, self.header.sound, self._pass_over)

    def _opening(self, start: int, packets: FramePackets) -> DecodedFrame:
        """The last keyframe at or before ``start`` that can be reconstructed."""
        key = self._survey.keyframe_before(start + 1)
        if key is None and not self._concealment.strict:
            key = self._without_index().keyframe_before(start + 1)
            if key is not None:
                self._pass_over_index(StreamError(Reason.INDEX_MISMATCH, "the index leaves out a keyframe"))
        if key is None:
            raise self._nothing_to_hold(start)
        while True:
            try:
                return self._decoded(self._packet(key, packets), None)
            except StreamError as error:  # noqa: PERF203 (one turn, unless keyframes are damaged)
                earlier = self._survey.keyframe_before(key)
                if not self._concealment.allows(error) or earlier is None:
                    raise
                key = earlier

    def _following(self, before: DecodedFrame, packets: FramePackets) -> DecodedFrame:
        """The frame after ``before``, which is held when that frame is damaged."""
        index, damage = before.index + 1, before.concealed
        if damage is None or index not in damage.frames:
            try:
                return self._decoded(self._packet(index, packets), before)
            except StreamError as error:
                if not self._concealment.allows(error):
                    raise
                resumes = self._survey.keyframe_after(index)
                lost = range(index, self.frame_count if resumes is None else resumes)
                damage = Damage(error, lost, before.shows)
                self._concealment.report(damage)
        return before.held(index, damage)

    def _decoded(self, packet: Packet, before: DecodedFrame | None) -> DecodedFrame:
        payload = split_payload(packet, self.header.corrected)
        first = self.first_keyframe() if payload.refers_to_first else None
        if self._refiner.top:
            refined = self._refined(payload, before)
            if refined is not None:
                return refined
            if before is not None and before.blocks is not None:
                before = self._base_of(before.index)
        return decode_frame(payload, before, self.header, first=first, max_gaussians=self._max_gaussians)

    def _refined(self, payload: FramePayload, before: DecodedFrame | None) -> DecodedFrame | None:
        """The frame with the layers that were asked for; None where one is damaged, up to the next keyframe."""
        frame, is_key = payload.body.frame, payload.body.kind == PacketKind.KEY
        blocks = None if before is None or is_key else before.blocks
        if blocks is None and not is_key:
            return None
        try:
            scene, sizes = self._refiner.refined(payload.body, blocks, self._first_blocks, self._max_gaussians)
            return layered_frame(payload, scene, sizes, before, self.header)
        except StreamError as error:
            if not self._concealment.allows(error):
                raise
            self._concealment.report(Damage(lost_refinement(error, frame)))
            return None

    def _base_of(self, frame: int) -> DecodedFrame:
        """A frame of the base alone, which frames in layers do not keep."""
        packets, shown = self._packets(), cast("DecodedFrame | None", None)
        for index in range(self._survey.keyframe_before(frame + 1) or 0, frame + 1):
            payload = split_payload(self._packet(index, packets), self.header.corrected)
            first = self.first_keyframe() if payload.refers_to_first else None
            shown = decode_frame(payload, shown, self.header, first=first, max_gaussians=self._max_gaussians)
        assert shown is not None
        return shown

    def _first_blocks(self) -> FirstKeyframe:
        """The first keyframe in layers, to which later ones refer; kept from the first time it is asked for."""
        if self._first_layers is None:
            base = split_payload(self._packet(0, self._packets()), self.header.corrected).body
            self._first_layers = self._refiner.first_keyframe(base, self._max_gaussians)
        return self._first_layers

    def first_keyframe(self) -> State:
        """The state that later keyframes refer to; kept from the first time it is asked for."""
        if self._first is None:
            packet = self._packet(0, self._packets())
            self._first = reconstruct(None, packet, self.header, max_gaussians=self._max_gaussians)
        return self._first

    def _packets(self) -> FramePackets:
        return FramePackets(lambda: self._survey, self._reader, self._pass_over)

    def _packet(self, frame: int, packets: FramePackets) -> Packet:
        """The packet of a frame; where the index led astray, it is passed over and the packet headers are scanned."""
        try:
            return packets.of(frame)
        except StreamError as error:
            if error.reason not in WRONG_INDEX or not self._concealment.allows(error):
                raise
            indexed = self._without_index().entry(frame)
            if indexed is None or indexed == self._survey.entry(frame):
                raise
            self._pass_over_index(error)
            return packets.of(frame)

    def _without_index(self) -> Survey:
        """Where the frames lie by the packet headers; found once."""
        if self._scanned is None:
            self._scanned = self._surveyed(by_index=False)
        return self._scanned

    def _pass_over_index(self, error: StreamError) -> None:
        """From now on frames lie where the packet headers are; ``error``: what is wrong with the index."""
        self._survey = self._without_index()
        self._concealment.report(Damage(error))
        for damage in self._survey.harmless():
            self._concealment.report(Damage(damage))

    def _pass_over(self, error: StreamError) -> None:
        """Damage before a frame's packet, in one that holds no frame."""
        if not self._concealment.allows(error):
            raise error
        self._concealment.report(Damage(error))

    def _nothing_to_hold(self, frame: int) -> StreamError:
        key = self._survey.keyframe_after(frame)
        message = f"frame {frame} needs a keyframe before it"
        if key is not None:
            message += f", and the first intact one is frame {key}; choose frames from there on"
        return StreamError(Reason.MISSING_KEY, message, offset=self._survey.cause(frame).offset)

    def _surveyed(self, *, by_index: bool = True) -> Survey:
        """Where the frames lie: from the index, else from the packet headers, else from a search past the damage."""
        max_frames = self._max_frames
        try:
            index = read_index(self._file, max_payload=self._max_payload, max_frames=max_frames) if by_index else None
            if index is not None:
                return survey(index, complete=True)
            entries = scan_index(self._file, max_frames=max_frames)
            reader, frames_declared = self._reader(entries[-1].offset if entries else 0), 0
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.END:
                    frames_declared, _ = end_fields(packet)
                    if self._concealment.strict:
                        check_count(packet, len(entries))
            unfinished = reader.pending
            if not unfinished or self._concealment.strict or reader.resynchronise() is None:
                return survey(
                    entries, complete=reader.ended, unfinished_bytes=unfinished, frames_declared=frames_declared
                )
        except StreamError as error:
            if not self._concealment.allows(error):
                raise
        return search(self._reader(0), max_frames=max_frames)

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._file.close()
            raise

    @contextmanager
    def _errors_named(self) -> Iterator[None]:
        """Also in the face of what is wrong only because the file changed."""
        try:
            with errors_name(self.path), limits_explained(self._max_memory, self._limits):
                yield
        finally:
            self._unchanged.check()

    def _check_open(self) -> None:
        if self._file.closed:
            raise UsageError(f"{self.path}: the stream is closed; read its frames while it is open")

    def _reader(self, offset: int) -> PacketReader:
        """A reader of the packets from ``offset`` on, where one must start."""
        file = io.BufferedReader(FileFrom(self._file, offset))
        return PacketReader(file, max_payload=self._max_payload, offset=offset)


def open_stream(
    path: str | os.PathLike[str],
    *,
    strict: bool = False,
    on_damage: OnDamage | None = None,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
    max_memory: int = DEFAULT_MAX_MEMORY,
    layer: str | int | None = None,
) -> Stream:
    """Opens a .dgs file; reads its header and where its frames lie, not the frames.

    ``strict`` makes damage an error, wherever it is met, and a file that stops inside a packet too. Otherwise the
    complete frames of such a file can be decoded (``unfinished_bytes`` counts the rest), damaged frames hold the last
    good one, and ``on_damage`` is called for every damaged place; when it is None, a DamageWarning is issued. What no
    reader can conceal is an error all the same: a damaged header, another version, a limit.

    ``max_memory`` bounds in bytes what decoding a stream can take beyond the program itself and up to 60 MB for the
    text of its header, ``max_gaussians`` its scene. ``layer``: the top one that is decoded, "base", its number or "all"
    (None).

    Raises StreamError for what is no readable stream, OSError when the file cannot be read.
    """
    return Stream(
        Path(path),
        strict=strict,
        on_damage=on_damage,
        max_gaussians=max_gaussians,
        max_memory=max_memory,
        layer=layer,
    )


def _opened(path: Path) -> BinaryIO:
    try:
        return open_regular(path)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
        raise UsageError(
            f"{path}: is no regular file; write the stream to a file first (`decogs-decode -` reads a pipe)"
        ) from None


def read_header(packet: Packet | None, offset: int) -> StreamHeader:
    """The header in a stream's first packet; None means that it is not there up to ``offset``."""
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops before its header is complete", offset=offset)
    return StreamHeader.from_bytes(packet.payload)


def in_its_world(header: StreamHeader) -> StreamHeader:
    """The header with its cameras where its transform takes them; the very object where it has none."""
    transform = header.presentation.similarity
    if transform.is_identity:
        return header
    return replace(header, cameras=tuple(transformed_camera(camera, transform) for camera in header.cameras))
