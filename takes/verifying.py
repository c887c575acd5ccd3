"""Whether a stream is what its footage and settings give: some of it is encoded again, and compared byte for byte.

A stream in layers is compared scene by scene: all layers together are what one layer would be.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.state import ARRAYS, State
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.encoding import encode
from decogs.encoder.job.job import EncodeJob
from decogs.encoder.output.observer import EncodeObserver
from decogs.encoder.output.reports import FrameReport
from decogs.encoder.output.resume import difference_of
from decogs.formats.errors import UsageError
from decogs.formats.files.regular_files import open_regular
from decogs.formats.frames.ranges import frames_text
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, PacketReader
from decogs.formats.system.callbacks import OnWarning

_LAYERS = "layers"
_RECORDED = "recorded"
"""The setting that has a digest of each training camera's first picture."""
FIRST_FRAMES = 3
"""Of a stream whose segments depend on each other."""


@dataclass(frozen=True)
class Verdict:
    """``frames`` of the stream that were encoded again; ``differences``: what is another, a line each."""

    frames: range
    differences: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Contents:
    """What a stream says: its header as plain values, and of each frame kind and payload of its packet, or a digest of
    its scene where ``scenes`` are compared."""

    header: Mapping[str, Any]
    frames: Mapping[int, tuple[int, bytes]]
    scenes: bool = False

    @property
    def settings(self) -> Mapping[str, Any]:
        settings: Mapping[str, Any] = self.header["settings"]
        return settings


def verify(
    stream: Path,
    job: EncodeJob,
    frame: int,
    observer: EncodeObserver,
    on_warning: OnWarning,
    recorded: Mapping[int, Mapping[str, str]] | None = None,
) -> Verdict:
    """Encodes again, as ``job`` asks, the closed segment that ``frame`` is in, or the first frames.

    ``job``: as the stream was encoded; its output counts for nothing. ``recorded``: digests of the pictures that it was
    encoded from, by the rig's frame and camera; without them, only those of the first frame are known. Raises
    UsageError for a stream that was edited since, and what `encode` raises.
    """
    kept = _read(stream)
    if _RECORDED not in kept.settings:
        raise UsageError(f"{stream}: was edited since it was encoded; verify the stream that was edited")
    noting = _Noting(observer, None if job.closed else FIRST_FRAMES)
    with tempfile.TemporaryDirectory() as folder:
        if job.closed:
            made, frames = _segment_again(kept, job, frame, Path(folder), noting, on_warning)
        else:
            made, frames = _beginning_again(kept, job, Path(folder), noting, on_warning)
    others = _other_pictures(recorded or {}, noting.recorded, int(kept.header["first_frame"]))
    return Verdict(frames, (*others, *_differences(kept, made, frames)))


def _beginning_again(
    kept: _Contents, job: EncodeJob, folder: Path, observer: EncodeObserver, on_warning: OnWarning
) -> tuple[_Contents, range]:
    """An encode of all frames, ended after the first ones: what it finds out about the rig depends on all."""
    output = folder / "again.dgs"
    encode(replace(job, output=output), progress=observer, on_warning=on_warning)
    return _read(output, scenes=kept.scenes), range(min(FIRST_FRAMES, len(kept.frames)))


def _segment_again(
    kept: _Contents, job: EncodeJob, frame: int, folder: Path, observer: EncodeObserver, on_warning: OnWarning
) -> tuple[_Contents, range]:
    if frame not in kept.frames:
        raise UsageError(f"`frame` {frame}: the stream has {len(kept.frames)} frames")
    begin = max(at for at in kept.frames if at <= frame and kept.frames[at][0] == PacketKind.KEY)
    end = min(
        (at for at in kept.frames if at > frame and kept.frames[at][0] == PacketKind.KEY), default=len(kept.frames)
    )
    first = int(kept.header["first_frame"])
    key, part = folder / "key.dgs", folder / "part.dgs"
    encode(replace(job, output=key, only=range(first, first + 1)), progress=observer, on_warning=on_warning)
    made = _read(key, scenes=kept.scenes)
    if begin or end > 1:
        encode(
            replace(job, output=part, only=range(first + begin, first + end), keyframe=key),
            progress=observer,
            on_warning=on_warning,
        )
        # A part begins with the keyframe that the others take, but for that part itself.
        again = _read(part, scenes=kept.scenes)
        offset = begin - (1 if begin else 0)
        others = {at + offset: packet for at, packet in again.frames.items() if at or not begin}
        made = replace(again, frames={**made.frames, **others})
    return made, range(begin, end)


def _other_pictures(
    was: Mapping[int, Mapping[str, str]], now: Mapping[int, Mapping[str, str]], first: int
) -> Iterator[str]:
    """Which cameras recorded other pictures, but for the first frame's, of which the header tells."""
    cameras: dict[str, list[int]] = {}
    for number in sorted(set(was) & set(now) - {first}):
        for name, digest in now[number].items():
            if was[number].get(name) != digest:
                cameras.setdefault(name, []).append(number - first)
    for name, numbers in cameras.items():
        yield f"camera {name} recorded other pictures of {frames_text(numbers)}"


def _differences(kept: _Contents, made: _Contents, frames: range) -> Iterator[str]:
    was, now = ([*each.settings.get(_RECORDED, {}).get("pictures", [])] for each in (kept, made))
    names = [camera["name"] for camera in kept.header["cameras"] if camera["name"] not in kept.header["held_out"]]
    if len(was) == len(now) == len(names):
        for name, one, other in zip(names, was, now, strict=True):
            if one != other:
                yield f"camera {name} recorded another first picture"
    settings = [
        {key: value for key, value in each.settings.items() if key not in (_RECORDED, "part")} for each in (kept, made)
    ]
    if settings[0] != settings[1]:
        yield f"the stream {difference_of(settings[0], settings[1])}"
    for frame in frames:
        if kept.frames.get(frame) != made.frames.get(frame):
            yield f"frame {frame} is another: {_said(kept, frame)} in the stream, {_said(made, frame)} encoded again"
            return  # what follows begins with it


def _said(contents: _Contents, frame: int) -> str:
    packet = contents.frames.get(frame)
    if packet is not None and contents.scenes:
        return "a scene"
    return "nothing" if packet is None else f"{len(packet[1])} bytes"


def _read(path: Path, *, scenes: bool = False) -> _Contents:
    """``scenes``: as of a stream in layers. Raises StreamError."""
    header: Mapping[str, Any] = {}
    frames: dict[int, tuple[int, bytes]] = {}
    with open_regular(path) as file:
        reader = PacketReader(file)
        while (packet := reader.next()) is not None:
            if packet.kind == PacketKind.HEADER:
                StreamHeader.from_bytes(packet.payload)
                header = json.loads(packet.payload)
            elif packet.kind in FRAME_KINDS:
                frames[packet.frame] = packet.kind, bytes(packet.payload)
    if not (scenes or header.get(_LAYERS)):
        return _Contents(header, frames)
    with open_stream(path, strict=True) as stream:
        digests = {frame.index: _digest(frame.state) for frame in stream.frames()}
    starts = {frame for frame, (kind, _) in frames.items() if kind == PacketKind.KEY}
    kinds = {frame: PacketKind.KEY if frame in starts else PacketKind.DELTA for frame in frames}
    return _Contents(header, {frame: (kinds[frame], digests[frame]) for frame in frames}, scenes=True)


def _digest(state: State) -> bytes:
    """Of all Gaussians' integers, in an order that does not depend on their ids."""
    columns = [getattr(state, name).reshape(len(state), -1) for name in ARRAYS if len(state)]
    rows = np.concatenate(columns, axis=1) if columns else np.zeros((0, 0), np.int32)
    return hashlib.sha256(np.ascontiguousarray(rows[np.lexsort(rows.T)] if len(rows) else rows).tobytes()).digest()


class _Noting(EncodeObserver):
    """Passes on what happens, notes digests of pictures by frame (``recorded``), and ends the encode after some frames,
    as Ctrl-C does; None for all."""

    def __init__(self, observer: EncodeObserver, frames: int | None) -> None:
        self._observer, self._left = observer, frames
        self.recorded: dict[int, Mapping[str, str]] = {}

    def look_step(self, step: int, steps: int) -> None:
        self._observer.look_step(step, steps)

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        self._observer.keyframe_step(step, steps, loss)

    def frame(self, report: FrameReport) -> None:
        self._observer.frame(report)
        self.recorded[report.frame] = report.recorded
        if self._left is not None:
            self._left -= 1
            if not self._left:
                raise KeyboardInterrupt
