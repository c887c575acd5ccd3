"""A .dgs stream, opened: its header, any range of its frames, and the picture of any view of one of them.

``render_view`` is the one way from splats to a picture: the decoder's commands and the encoder's preview both use it,
which is why their pixels are equal.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from decogs.codec.corrections import Correction, Corrections, split_corrections
from decogs.codec.deltas import Delta
from decogs.codec.header import StreamHeader
from decogs.codec.lattice import Lattice, dequantise
from decogs.codec.reconstruct import reconstruct
from decogs.codec.state import DEFAULT_MAX_GAUSSIANS, MAX_GAUSSIANS, State, same_scene
from decogs.codec.syntax import key_changes, payload_costs, read_delta, refers_to_first
from decogs.formats.cameras import Camera, as_pinhole, scale_camera
from decogs.formats.container import (
    FRAME_KINDS,
    MAX_PAYLOAD,
    IndexEntry,
    Packet,
    PacketKind,
    PacketReader,
    check_count,
    end_fields,
    read_index,
    scan_index,
    stops_inside,
)
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.reasons import Reason
from decogs.formats.splats import Splats
from decogs.formats.survey import Survey, search, survey

from .camera_faults import as_it_stood, with_recorded_colours
from .damage import Concealment, Damage, OnDamage, errors_name
from .lens import Redistortion, is_distorted
from .memory import (
    DEFAULT_MAX_MEMORY,
    check_picture,
    frames_within,
    gaussians_within,
    limits_explained,
    pairs_within,
    payload_within,
)

if TYPE_CHECKING:
    from .rasterise import Rendering

_ASTRAY = frozenset(
    {Reason.INDEX_MISMATCH, Reason.BAD_SYNC, Reason.BAD_HEADER_CRC, Reason.TRUNCATED, Reason.MISPLACED_PACKET}
)
"""What is found where an index that is wrong says that a frame lies."""

MAX_PICTURE_PIXELS = 1 << 26
"""No larger picture is rendered (8192 x 8192): a few header bytes must not be able to claim all memory."""


class _Activation:
    """The stored values of a state, computed when first asked for; shared by the frames that keep the state."""

    def __init__(self, state: State, lattice: Lattice) -> None:
        self._state, self._lattice = state, lattice

    @cached_property
    def splats(self) -> Splats:
        return dequantise(self._state, self._lattice)


class DecodedFrame:
    """One frame of a stream: what its packet says and the scene after it.

    ``index`` counts frames from 0; ``kind`` is KEY, DELTA or SKIP; ``packet_bytes`` are its bytes on disk, container
    overhead included; ``state`` is the scene as lattice integers with ids, checked against the encoder's digest;
    ``corrections`` tell of the cameras that the header names how their pictures differ from the scene.

    ``concealed`` is None, unless the frame could not be reconstructed: then it is what is wrong, ``kind`` is None,
    ``packet_bytes`` 0, and the scene that of the last good frame.
    """

    def __init__(
        self,
        packet: Packet,
        state: State,
        header: StreamHeader,
        before: DecodedFrame | None,
        first: State | None = None,
    ) -> None:
        self.index = packet.frame
        self.kind: PacketKind | None = PacketKind(packet.kind)
        self.packet_bytes = packet.size
        self.state = state
        self.concealed: Damage | None = None
        self._packet: Packet | None
        self.corrections, self._packet = split_corrections(packet, header.corrected)
        self._coefficients = header.coefficients
        self._state_before = None if before is None else before.state
        self._first = first
        unchanged = before is not None and self.kind == PacketKind.SKIP
        self._activation: _Activation = (
            before._activation if before and unchanged else _Activation(state, header.lattice)
        )

    def held(self, index: int, damage: Damage) -> DecodedFrame:
        """This frame shown once more in place of a damaged one."""
        frame = copy(self)
        frame.index, frame.concealed = index, damage
        frame.kind, frame.packet_bytes, frame._packet = None, 0, None
        frame.state = replace(self.state, frame=index)
        return frame

    @property
    def shows(self) -> int | None:
        """The index of the frame whose scene this is: its own, unless it is held."""
        return self.index if self.concealed is None else self.concealed.held

    @property
    def splats(self) -> Splats:
        """The scene as stored values, float32; the very object of the frame before when nothing changed."""
        return self._activation.splats

    @property
    def refers_to_first(self) -> bool:
        """Whether this is a keyframe told as the difference from the stream's first one."""
        return self._packet is not None and refers_to_first(self._packet)

    @property
    def costs(self) -> dict[str, int]:
        """The payload's bytes by purpose: header, index set, each attribute group (see SPEC.md, "Payloads")."""
        if self._packet is None:
            return {}
        base = self._first if self.kind == PacketKind.KEY else self._state_before
        return payload_costs(self._packet, self._coefficients, None if base is None else len(base))

    def delta_from(self, state: State) -> Delta | None:
        """What this frame changed of ``state``, read from its packet again; None unless it is a delta to that scene."""
        before = self._state_before
        if self._packet is None or self.kind != PacketKind.DELTA or before is None or not same_scene(before, state):
            return None
        delta, _ = read_delta(self._packet, before, max_gaussians=MAX_GAUSSIANS)
        return delta

    @property
    def changes(self) -> Changes:
        """How many Gaussians this frame touched, added and removed; a keyframe brings all of them anew.

        One that refers to the first keyframe counts against that.
        """
        delta = None if self._state_before is None else self.delta_from(self._state_before)
        if delta is not None:
            return Changes(len(delta.rows), len(delta.added), len(delta.removed))
        if self._first is not None and self._packet is not None:
            return Changes(*key_changes(self._packet, self._first))
        return Changes(0, len(self.state) if self.kind == PacketKind.KEY else 0, 0)


@dataclass(frozen=True)
class Changes:
    """Numbers of Gaussians: existing ones whose values changed, new ones, and ones that went."""

    touched: int
    added: int
    removed: int


class Stream:
    """An open .dgs file; a context manager. Build one with ``open_stream``.

    ``header`` is the stream's header, ``version`` (major, minor) its bitstream's; ``complete`` tells whether the stream
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
    ) -> None:
        self.path = path
        self._concealment = Concealment(path, strict=strict, on_damage=on_damage)
        self._file = open(path, "rb")  # noqa: SIM115 (closed by __exit__)
        self._max_memory, self._max_payload = max_memory, payload_within(max_memory)
        self._max_frames = frames_within(max_memory)
        self._limits = {self._max_payload, self._max_frames} - {MAX_PAYLOAD}
        with self._closed_on_error(), self._errors_named():
            if not self._file.seekable():
                raise UsageError(
                    f"{path}: cannot be seeked, as a pipe; decode it with - for stdin, or write it to a file first"
                )
            reader = self._reader(0)
            self.header = read_header(reader.next(), reader.offset)
            self.version = reader.version
            self._survey = self._surveyed()
            self._scanned: Survey | None = None
            self.complete, self.unfinished_bytes = self._survey.complete, self._survey.unfinished_bytes
            if strict and self.unfinished_bytes:
                raise stops_inside(self.unfinished_bytes, self.file_bytes - self.unfinished_bytes)
            self._max_gaussians = gaussians_within(max_memory, self.header.coefficients, max_gaussians)
            self._limits |= {self._max_gaussians} - {max_gaussians}
            self._first: State | None = None
        for error in self._survey.harmless():
            self._concealment.tell(Damage(error))

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

    def _opening(self, start: int, packets: _FramePackets) -> DecodedFrame:
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

    def _following(self, before: DecodedFrame, packets: _FramePackets) -> DecodedFrame:
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
                self._concealment.tell(damage)
        return before.held(index, damage)

    def _decoded(self, packet: Packet, before: DecodedFrame | None) -> DecodedFrame:
        state_before = None if before is None else before.state
        refers = refers_to_first(split_corrections(packet, self.header.corrected)[1])
        first = self._first_keyframe() if refers else None
        state = reconstruct(state_before, packet, self.header, first=first, max_gaussians=self._max_gaussians)
        return DecodedFrame(packet, state, self.header, before, first)

    def _first_keyframe(self) -> State:
        """The state that later keyframes refer to; kept from the first time it is asked for."""
        if self._first is None:
            packet = self._packet(0, self._packets())
            self._first = reconstruct(None, packet, self.header, max_gaussians=self._max_gaussians)
        return self._first

    def _packets(self) -> _FramePackets:
        return _FramePackets(lambda: self._survey, self._reader, self._pass_over)

    def _packet(self, frame: int, packets: _FramePackets) -> Packet:
        """The packet of a frame; where the index led astray, it is passed over and the packet headers are scanned."""
        try:
            return packets.of(frame)
        except StreamError as error:
            if error.reason not in _ASTRAY or not self._concealment.allows(error):
                raise
            place = self._without_index().entry(frame)
            if place is None or place == self._survey.entry(frame):
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
        self._concealment.tell(Damage(error))
        for found in self._survey.harmless():
            self._concealment.tell(Damage(found))

    def _pass_over(self, error: StreamError) -> None:
        """Damage before a frame's packet, in one that holds no frame."""
        if not self._concealment.allows(error):
            raise error
        self._concealment.tell(Damage(error))

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
            reader, frames_told = self._reader(entries[-1].offset if entries else 0), 0
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.END:
                    frames_told, _ = end_fields(packet)
                    if self._concealment.strict:
                        check_count(packet, len(entries))
            unfinished = reader.pending
            if not unfinished or self._concealment.strict or reader.resynchronise() is None:
                return survey(entries, complete=reader.ended, unfinished_bytes=unfinished, frames_told=frames_told)
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
        with errors_name(self.path), limits_explained(self._max_memory, self._limits):
            yield

    def _check_open(self) -> None:
        if self._file.closed:
            raise UsageError(f"{self.path}: the stream is closed; read its frames while it is open")

    def _reader(self, offset: int) -> PacketReader:
        """A reader of the packets from ``offset`` on, where one must start."""
        file = io.BufferedReader(_At(self._file, offset))
        return PacketReader(file, max_payload=self._max_payload, offset=offset)


class _FramePackets:
    """The packets of frames in rising order, read one after the other as long as none is damaged or passed over."""

    def __init__(
        self,
        places: Callable[[], Survey],
        reader_at: Callable[[int], PacketReader],
        pass_over: Callable[[StreamError], None],
    ) -> None:
        self._places, self._reader_at, self._pass_over = places, reader_at, pass_over
        self._reader: PacketReader | None = None
        self._last: int | None = None

    def of(self, frame: int) -> Packet:
        """The packet of a frame; raises StreamError when it is lost or damaged."""
        places = self._places()
        entry = places.entry(frame)
        reader, self._reader = self._reader, None
        if entry is None:
            raise places.cause(frame)
        if reader is None or self._last != frame - 1:
            # From the very start when no frame is passed over: errors can then count packets.
            reader = self._reader_at(0 if entry == places.entries[0] else entry.offset)
        try:
            packet = _next_frame(reader, entry)
        except StreamError as error:
            if reader.offset >= entry.offset:
                raise
            self._pass_over(error)
            reader = self._reader_at(entry.offset)
            packet = _next_frame(reader, entry)
        self._reader, self._last = reader, frame
        return packet


def _next_frame(reader: PacketReader, entry: IndexEntry) -> Packet:
    while (packet := reader.next()) is not None and packet.kind not in FRAME_KINDS:
        pass
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops inside a packet", offset=reader.offset)
    if (packet.offset, packet.kind, packet.frame) != (entry.offset, entry.kind, entry.frame):
        message = f"the index says that frame {entry.frame} lies elsewhere"
        raise StreamError(Reason.INDEX_MISMATCH, message, packet=packet.ordinal, offset=packet.offset)
    return packet


def open_stream(
    path: str | os.PathLike[str],
    *,
    strict: bool = False,
    on_damage: OnDamage | None = None,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
    max_memory: int = DEFAULT_MAX_MEMORY,
) -> Stream:
    """Opens a .dgs file; reads its header and where its frames lie, not the frames.

    ``strict`` makes damage an error, wherever it is met, and a file that stops inside a packet too. Otherwise the
    complete frames of such a file can be decoded (``unfinished_bytes`` tells), damaged frames hold the last good one,
    and ``on_damage`` is told of every damaged place; when it is None, a DamageWarning is issued. What no reader can
    conceal is an error all the same: a damaged header, another version, a limit.

    ``max_memory`` bounds in bytes what decoding a stream can take beyond the program itself and up to 60 MB for the
    text of its header, ``max_gaussians`` its scene.

    Raises StreamError for what is no readable stream, OSError when the file cannot be read.
    """
    return Stream(
        Path(path),
        strict=strict,
        on_damage=on_damage,
        max_gaussians=max_gaussians,
        max_memory=max_memory,
    )


def camera_named(header: StreamHeader, name: str) -> Camera:
    """The rig camera of this name; raises UsageError that lists the names there are."""
    for camera in header.cameras:
        if camera.name == name:
            return camera
    names = [camera.name for camera in header.cameras]
    listed = ", ".join(names[:40]) + (", ..." if len(names) > 40 else "")
    raise UsageError(f"there is no camera {name!r} in this stream; it has {listed}")


def render_view(
    header: StreamHeader,
    splats: Splats,
    view: str | Camera,
    *,
    scale: float = 1.0,
    background: tuple[float, float, float] | None = None,
    undistorted: bool = False,
    threads: int = 0,
    corrections: Corrections | None = None,
    max_memory: int | None = None,
) -> Rendering:
    """What a camera of the rig (by name), or any other camera, sees of a frame: image, alpha and depth.

    The picture has the camera's own size times ``scale``, and its lens distortion unless ``undistorted``.
    ``corrections``: the frame's; a camera of the rig then shows what it recorded, from where it stood in that frame and
    with its exposure and white balance. Without them, and from any other camera, it is the scene's own colours.
    ``background``: display-referred RGB, the header's when None; it also fills what a lens sees past the rendered
    pinhole. ``threads`` 0 means all processors. Raises UsageError for an unknown camera, an impossible size, and what
    needs more than ``max_memory`` bytes, the scene included.
    """
    from .rasterise import render

    correction = correction_of(view, corrections)
    plan = view_plan(header, view, scale=scale, undistorted=undistorted, correction=correction, max_memory=max_memory)
    background = header.background if background is None else background
    pairs = max_pairs(header, len(splats), plan, max_memory)
    drawn = render(splats, plan.render_camera, background, threads=threads, max_pairs=pairs)
    seen = through_lens(plan, drawn, background)
    return seen if correction is None else with_recorded_colours(seen, correction)


def camera_of(header: StreamHeader, view: str | Camera) -> Camera:
    """The camera that a view is: one of the rig by name, or any other; raises UsageError for an unknown name."""
    return camera_named(header, view) if isinstance(view, str) else view


def correction_of(view: str | Camera, corrections: Corrections | None) -> Correction | None:
    """That of a rig camera, by name; None where nothing is corrected."""
    return None if corrections is None or not isinstance(view, str) else corrections.get(view)


def view_plan(
    header: StreamHeader,
    view: str | Camera,
    *,
    scale: float,
    undistorted: bool,
    correction: Correction | None = None,
    max_memory: int | None = None,
) -> Redistortion:
    """What to render for the view that ``render_view`` takes, and the way from there to its own pixels."""
    camera = scaled_view(camera_of(header, view), scale)
    if correction is not None:
        camera = as_it_stood(camera, correction)
    camera = as_pinhole(camera) if undistorted else camera
    lens = is_distorted(camera)
    if max_memory is not None:
        check_picture(camera, max_memory, lens=lens)  # before its tables are made
    plan = Redistortion(camera)
    if max_memory is not None:
        check_picture(camera, max_memory, lens=lens, rendered=plan.render_camera)
    return plan


def max_pairs(header: StreamHeader, gaussians: int, plan: Redistortion, max_memory: int | None) -> int:
    """How many pairs of a 16x16 tile and a Gaussian a picture of so many Gaussians may list."""
    from .rasterise.native import MAX_PAIRS

    if max_memory is None:
        return MAX_PAIRS
    lens = not plan.is_identity
    return min(
        MAX_PAIRS,
        pairs_within(max_memory, gaussians, header.coefficients, plan.camera, plan.render_camera, lens=lens),
    )


def through_lens(plan: Redistortion, seen: Rendering, background: tuple[float, float, float]) -> Rendering:
    """The rendering of ``plan.render_camera`` as the view's own camera sees it; the same object without a lens."""
    from .rasterise import Rendering

    if plan.is_identity:
        return seen
    return Rendering(
        plan.apply(seen.image, outside=background),
        np.clip(plan.apply(seen.alpha), 0.0, 1.0),
        plan.apply(seen.depth, nearest=True),
    )


def scaled_view(camera: Camera, scale: float) -> Camera:
    """The camera at ``scale`` times its size; raises UsageError when that is no size a picture can have."""
    if not (np.isfinite(scale) and scale > 0):
        raise UsageError(f"a scale of {scale:g} is not possible; give one above 0, such as 0.5")
    if scale * camera.width * scale * camera.height <= 2 * MAX_PICTURE_PIXELS:  # a far larger one is no camera at all
        scaled = scale_camera(camera, scale)
        if scaled.width * scaled.height <= MAX_PICTURE_PIXELS:
            return scaled
    raise UsageError(
        f"camera {camera.name!r}: {scale:g} times its {camera.width}x{camera.height} is above the limit of "
        f"{MAX_PICTURE_PIXELS} pixels; choose a smaller scale"
    )


_RANGE = re.compile(r"\s*([+-]?[0-9]{1,4000})?\s*:\s*([+-]?[0-9]{1,4000})?\s*", re.ASCII)


def frame_range(text: str) -> slice:
    """A range of frames as the user writes it: "A:B", half-open as in Python, each end may be missing or negative.

    Raises UsageError for anything else.
    """
    ends = _RANGE.fullmatch(text)
    if ends is None:
        raise UsageError(f"frames {text!r} are no range; write A:B, half-open as in Python, such as 0:10 or -5:")
    first, last = (int(end) if end else None for end in ends.groups())
    return slice(first, last)


class _At(io.RawIOBase):
    """A file read from a place of its own, so that several readers can share one open file."""

    def __init__(self, file: io.BufferedReader, offset: int) -> None:
        self._file, self._offset = file, offset

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        # The file is asked for its descriptor each time: once closed it has none, and the number is another file's.
        data = os.pread(self._file.fileno(), len(buffer), self._offset)
        buffer[: len(data)] = data
        self._offset += len(data)
        return len(data)


def read_header(packet: Packet | None, offset: int) -> StreamHeader:
    """The header in a stream's first packet; None means that it is not there up to ``offset``."""
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops before its header is complete", offset=offset)
    return StreamHeader.from_bytes(packet.payload)
