"""A .dgs stream, opened: its header, any range of its frames, and the picture of any view of one of them.

``render_view`` is the one way from splats to a picture: the decoder's commands and the encoder's preview both use it,
which is why their pixels are equal.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

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
    read_index,
    scan_index,
)
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.reasons import Reason
from decogs.formats.splats import Splats

from .lens import Redistortion

if TYPE_CHECKING:
    from .rasterise import Rendering

MAX_PICTURE_PIXELS = 1 << 26
"""No larger picture is rendered (8192 x 8192): a few header bytes must not be able to claim all memory."""

_COPIES = 7
"""States and splats that are alive at once while a delta is applied, generously counted, and the first keyframe; for
``max_memory``."""


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
    overhead included; ``state`` is the scene as lattice integers with ids, checked against the encoder's digest.
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
        self.kind = PacketKind(packet.kind)
        self.packet_bytes = packet.size
        self.state = state
        self._packet, self._coefficients = packet, header.coefficients
        self._state_before = None if before is None else before.state
        self._first = first
        unchanged = before is not None and self.kind == PacketKind.SKIP
        self._activation: _Activation = (
            before._activation if before and unchanged else _Activation(state, header.lattice)
        )

    @property
    def splats(self) -> Splats:
        """The scene as stored values, float32; the very object of the frame before when nothing changed."""
        return self._activation.splats

    @property
    def refers_to_first(self) -> bool:
        """Whether this is a keyframe told as the difference from the stream's first one."""
        return refers_to_first(self._packet)

    @property
    def costs(self) -> dict[str, int]:
        """The payload's bytes by purpose: header, index set, each attribute group (see SPEC.md, "Payloads")."""
        return payload_costs(self._packet, self._coefficients)

    def delta_from(self, state: State) -> Delta | None:
        """What this frame changed of ``state``, read from its packet again; None unless it is a delta to that scene."""
        before = self._state_before
        if self.kind != PacketKind.DELTA or before is None or not same_scene(before, state):
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
        if self._first is not None:
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

    def __init__(self, path: Path, *, max_gaussians: int, max_memory: int | None) -> None:
        self.path = path
        self._file = open(path, "rb")  # noqa: SIM115 (closed by __exit__)
        with self._closed_on_error(), errors_name(path):
            self._max_payload = MAX_PAYLOAD if max_memory is None else min(MAX_PAYLOAD, max_memory // 4)
            reader = self._reader(0)
            self.header = read_header(reader.next(), reader.offset)
            self.version = reader.version
            index = read_index(self._file)
            self._entries = scan_index(self._file) if index is None else index
            self.complete, self.unfinished_bytes = (True, 0) if index is not None else self._tail()
            self._max_gaussians = _gaussians_within(max_memory, self.header.coefficients, max_gaussians)
            self._first: State | None = None

    def __enter__(self) -> Stream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    @property
    def frame_count(self) -> int:
        """Frames whose packets are complete."""
        return len(self._entries)

    @property
    def file_bytes(self) -> int:
        """Bytes of the file as it is on disk."""
        return os.fstat(self._file.fileno()).st_size

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[DecodedFrame]:
        """The frames from ``start`` up to, not including, ``stop`` (the stream's end when None), in order.

        Reading begins at the last keyframe at or before ``start``; the stream's first one is read, too, where that one
        refers to it. Every frame's checksums and state digest are verified. Raises StreamError at damage, UsageError
        when the range is not one of this stream.
        """
        stop = self.frame_count if stop is None else stop
        if not 0 <= start <= stop <= self.frame_count:
            raise UsageError(f"{self.path}: frames {start}:{stop} are not in this stream of {self.frame_count} frames")
        if start == stop:
            return
        key = self._keyframe_before(start)
        # From the very start when no keyframe is passed over: errors can then count packets.
        reader = self._reader(0 if key == 0 else self._entries[key].offset)
        frame: DecodedFrame | None = None
        for position in range(key, stop):
            with errors_name(self.path):
                frame = self._decoded(self._next_frame(reader, self._entries[position]), frame)
            if position >= start:
                yield frame

    def _decoded(self, packet: Packet, before: DecodedFrame | None) -> DecodedFrame:
        state_before = None if before is None else before.state
        first = self._first_keyframe() if refers_to_first(packet) else None
        state = reconstruct(state_before, packet, self.header, first=first, max_gaussians=self._max_gaussians)
        return DecodedFrame(packet, state, self.header, before, first)

    def _first_keyframe(self) -> State:
        """The state that later keyframes refer to; kept from the first time it is asked for."""
        if self._first is None:
            entry = self._entries[0]
            packet = self._next_frame(self._reader(entry.offset), entry)
            self._first = reconstruct(None, packet, self.header, max_gaussians=self._max_gaussians)
        return self._first

    def _next_frame(self, reader: PacketReader, entry: IndexEntry) -> Packet:
        while (packet := reader.next()) is not None and packet.kind not in FRAME_KINDS:
            pass
        if packet is None:
            raise StreamError(Reason.TRUNCATED, "the stream stops inside a packet", offset=reader.offset)
        if (packet.offset, packet.kind, packet.frame) != (entry.offset, entry.kind, entry.frame):
            message = f"the index says that frame {entry.frame} lies elsewhere"
            raise StreamError(Reason.INDEX_MISMATCH, message, packet=packet.ordinal, offset=packet.offset)
        return packet

    def _keyframe_before(self, position: int) -> int:
        keys = [i for i in range(position + 1) if self._entries[i].kind == PacketKind.KEY]
        if not keys:
            raise StreamError(Reason.MISSING_KEY, f"{self.path}: frame {position} needs a keyframe before it")
        return keys[-1]

    @contextmanager
    def _closed_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            self._file.close()
            raise

    def _tail(self) -> tuple[bool, int]:
        """Whether the stream was finished (end packet), and the bytes of an incomplete packet at its tail."""
        reader = self._reader(self._entries[-1].offset if self._entries else 0)
        while reader.next() is not None:
            pass
        return reader.ended, reader.pending

    def _reader(self, offset: int) -> PacketReader:
        file = io.BufferedReader(_At(self._file.fileno(), offset))
        return PacketReader(file, max_payload=self._max_payload, offset=offset)


def open_stream(
    path: str | os.PathLike[str],
    *,
    strict: bool = True,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
    max_memory: int | None = None,
) -> Stream:
    """Opens a .dgs file; reads its header and where its frames lie, not the frames.

    A file that stops inside a packet is an error when ``strict``; otherwise its complete frames can be decoded and
    ``unfinished_bytes`` tells. ``max_gaussians`` and ``max_memory`` (bytes) bound what a hostile stream can claim.
    Raises StreamError for what is no readable stream, OSError when the file cannot be read.
    """
    stream = Stream(Path(path), max_gaussians=max_gaussians, max_memory=max_memory)
    if strict and stream.unfinished_bytes:
        with stream:
            message = f"{path}: the stream stops {stream.unfinished_bytes} bytes into a packet"
            raise StreamError(Reason.TRUNCATED, message, offset=stream.file_bytes - stream.unfinished_bytes)
    return stream


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
) -> Rendering:
    """What a camera of the rig (by name), or any other camera, sees of a frame: image, alpha and depth.

    The picture has the camera's own size times ``scale``, and its lens distortion unless ``undistorted``.
    ``background``: display-referred RGB, the header's when None; it also fills what a lens sees past the rendered
    pinhole. ``threads`` 0 means all processors. Raises UsageError for an unknown camera or an impossible size.
    """
    from .rasterise import render

    plan = view_plan(header, view, scale=scale, undistorted=undistorted)
    background = header.background if background is None else background
    return through_lens(plan, render(splats, plan.render_camera, background, threads=threads), background)


def view_plan(header: StreamHeader, view: str | Camera, *, scale: float, undistorted: bool) -> Redistortion:
    """What to render for the view that ``render_view`` takes, and the way from there to its own pixels."""
    camera = scaled_view(camera_named(header, view) if isinstance(view, str) else view, scale)
    return Redistortion(as_pinhole(camera) if undistorted else camera)


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
    scaled = scale_camera(camera, scale)
    if scaled.width * scaled.height > MAX_PICTURE_PIXELS:
        raise UsageError(
            f"camera {camera.name!r}: a picture of {scaled.width}x{scaled.height} is above the limit of "
            f"{MAX_PICTURE_PIXELS} pixels; choose a smaller scale"
        )
    return scaled


def frame_range(text: str) -> slice:
    """A range of frames as the user writes it: "A:B", half-open as in Python, each end may be missing or negative.

    Raises UsageError for anything else.
    """
    ends = text.split(":")
    try:
        first, last = (int(end) if end.strip() else None for end in ends)
    except ValueError:
        raise UsageError(
            f"frames {text!r} are no range; write A:B, half-open as in Python, such as 0:10 or -5:"
        ) from None
    return slice(first, last)


@contextmanager
def errors_name(path: Path | str) -> Iterator[None]:
    """Puts the file's name before what the container and the codec, which know bytes only, have to say."""
    try:
        yield
    except StreamError as error:
        error.args = (f"{path}: {error}",)
        raise


class _At(io.RawIOBase):
    """A file read from a place of its own, so that several readers can share one open file."""

    def __init__(self, descriptor: int, offset: int) -> None:
        self._descriptor, self._offset = descriptor, offset

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = os.pread(self._descriptor, len(buffer), self._offset)
        buffer[: len(data)] = data
        self._offset += len(data)
        return len(data)


def read_header(packet: Packet | None, offset: int) -> StreamHeader:
    """The header in a stream's first packet; None means that it is not there up to ``offset``."""
    if packet is None:
        raise StreamError(Reason.TRUNCATED, "the stream stops before its header is complete", offset=offset)
    return StreamHeader.from_bytes(packet.payload)


def _gaussians_within(max_memory: int | None, coefficients: int, max_gaussians: int) -> int:
    """The Gaussians that fit: each has 11 + 3 K numbers of 4 bytes and an id of 8."""
    if max_memory is None:
        return max_gaussians
    return min(max_gaussians, max_memory // (_COPIES * (4 * (11 + 3 * coefficients) + 8)))
