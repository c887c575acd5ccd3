"""Edits a stream without training: what ``decogs-edit`` does."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.profiles import PROFILES
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import PNG, STREAM, GrowingFile, Output, check_outputs, errors_named, is_device
from decogs.formats.stream.container import LAYERED_VERSION, VERSION, PacketKind, StreamWriter
from decogs.formats.system.callbacks import OnProgress, OnWarning
from decogs.formats.system.threads import thread_count

from ..limits import DEFAULT_MAX_MEMORY
from .layers import LayerWriter
from .measuring import Meter, Nowhere
from .operations.base import Operation
from .recipe import read_recipe
from .take import Frame, Take, open_take
from .writing import FrameWriter

MAX_OPERATIONS = 100
"""Of one edit: each of them reads frames through all those before it, one within the other. 300 `grade` of 11 000
Gaussians keep 500 MB of scenes, 80 `crop` take 3 s a frame, and Python goes no deeper than some 900."""

_PART, _RECORDED = "part", "recorded"
"""Settings of which part of an encode a stream is, and of what footage (``encoder.parts``,
``rig.pictures.recording_digests``)."""


@dataclass(frozen=True)
class EditReport:
    """What an edit made: frames, and how many of them kept the packet that was read; the bytes of the stream.

    ``notes``: a line or more of each operation, in their order.
    """

    frame_count: int
    kept_packets: int
    file_bytes: int
    notes: tuple[str, ...]


def edit(
    stream: str | os.PathLike[str],
    output: str | os.PathLike[str] | BinaryIO | None,
    operations: Sequence[Operation],
    *,
    recipe: str | os.PathLike[str] | None = None,
    max_memory: int = DEFAULT_MAX_MEMORY,
    threads: int = 0,
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> EditReport:
    """Writes the stream with ``operations`` done to it, one after the other; nothing is trained.

    ``recipe``: a file of operations that come before those.

    Scenes that no operation changes keep their bits, rows that none changes theirs; sound goes with its frames. Packets
    pass one by one: memory does not grow with the take. METRICS and private packets are left out, since they tell of
    the stream that was; layers are measured anew. ``output``: a file's name, or an open file; None only finds out what
    the edit would do, and writes nothing.
    ``max_memory`` (bytes) bounds the decoding of each stream, as in ``open_stream``; ``threads``: of what an operation
    trains, 0 for all processors. ``on_frame(done, all)`` reports progress, ``on_warning(text)`` damage that is passed
    over.

    Raises UsageError, StreamError or OSError; nothing is then left under the output's name.
    """
    operations = [*([] if recipe is None else read_recipe(recipe)), *operations]
    if len(operations) > MAX_OPERATIONS:
        raise UsageError(
            f"{len(operations)} operations are too many; give up to {MAX_OPERATIONS} at once, "
            "and edit what comes out with the others"
        )
    target = Path(output) if isinstance(output, (str, os.PathLike)) else output
    with ExitStack() as opened:
        numbers = count()

        def open_other(path: str | os.PathLike[str]) -> Take:
            return opened.enter_context(open_take(path, next(numbers), max_memory=max_memory, on_warning=on_warning))

        shown = _Shown(on_frame)
        take = replace(open_other(stream).each(shown.read), threads=thread_count(threads))
        for operation in operations:
            operation.check_numbers()
            take = operation.edit(take, open_other)
            _check_header(operation, take)
        keeps_scenes = all(operation.keeps_scenes for operation in operations)
        take = replace(take, header=_edited(take.header, keeps_scenes=keeps_scenes))
        _check_files(target, operations, [*take.sources, *([] if recipe is None else [Path(recipe)])])
        with _opened(target) as (file, publish):
            writer, frames = _written(take, file, shown)
            publish()
        if frames.is_empty and on_warning is not None:
            on_warning("no Gaussian is left in any frame; the stream shows its background alone")
        return EditReport(frames.frames, frames.kept, writer.bytes_written, tuple(note() for note in take.notes))


def _edited(header: StreamHeader, *, keeps_scenes: bool) -> StreamHeader:
    """The header without settings that only hold of the stream as it was encoded."""
    gone = {_PART} if keeps_scenes else {_PART, _RECORDED}
    return replace(header, settings={name: value for name, value in header.settings.items() if name not in gone})


class _Shown:
    """Progress: frames that were written.

    It is told of frames that are read, too: an operation may read all of them before the first one is written.
    """

    def __init__(self, on_frame: OnProgress | None) -> None:
        self._on_frame, self.done, self.total = on_frame, 0, 0

    def read(self, frame: Frame) -> Frame:
        self.to(self.done)
        return frame

    def to(self, done: int) -> None:
        self.done = done
        if self._on_frame is not None:
            self._on_frame(done, self.total)


def _written(take: Take, file: BinaryIO, shown: _Shown) -> tuple[StreamWriter, FrameWriter | LayerWriter]:
    """The take in the file; it is written twice where its header says what the packets measure."""
    header = take.header if take.profile is None and not take.header.layers else _measured(take, shown)
    return _packets(take, StreamWriter(file, header.to_bytes(), LAYERED_VERSION if header.layers else VERSION), shown)


def _measured(take: Take, shown: _Shown) -> StreamHeader:
    """The header with what packets measure. Raises UsageError where they do not keep within the take's profile."""
    header = take.header
    meter = Meter(header)
    _packets(take, meter, shown)
    header = replace(header, layers=meter.layers())
    if take.profile is None:
        return header
    loads = meter.loads()
    if take.profile and (excess := loads[0].excess(PROFILES[take.profile])):
        base = "the base" if header.layers else "the stream"
        raise UsageError(f"profile {take.profile}: {base} does not keep within it: {excess}")
    return replace(header, profiles=tuple(each.profile for each in loads))


def _packets(take: Take, writer: StreamWriter, shown: _Shown) -> tuple[StreamWriter, FrameWriter | LayerWriter]:
    frames = LayerWriter(take.header, writer) if take.header.layers else FrameWriter(take.header, writer)
    shown.total = take.frame_count
    for frame, sound in zip(take.read(0, take.frame_count), take.hear(0, take.frame_count), strict=True):
        frames.write(frame)
        for packet in sound:
            writer.write(PacketKind.SOUND, frames.frames - 1, packet.payload())
        if isinstance(writer, Meter):
            writer.count(frame)
        shown.to(frames.frames)
    frames.finish()
    writer.finish()
    return writer, frames


def _check_header(operation: Operation, take: Take) -> None:
    """Raises UsageError where what was asked for is out of a header's bounds."""
    try:
        take.header.to_bytes()
    except StreamError as error:
        raise UsageError(f"{operation.name}: {error}") from None


def _check_files(target: Path | BinaryIO | None, operations: Sequence[Operation], read: Sequence[Path]) -> None:
    outputs = [Output(operation.name, file, format=PNG) for operation in operations for file in operation.outputs]
    if target is not None:
        outputs.insert(0, Output("output", target, grows=True, format=STREAM))
    check_outputs(outputs, [(path, "is read, and an edit never replaces what it reads") for path in read])


@contextmanager
def _opened(target: Path | BinaryIO | None) -> Iterator[tuple[BinaryIO, Any]]:
    """The file to write into, and what gives it its name; without that, nothing is left of it."""
    if target is None:
        yield Nowhere(), lambda: None
    elif not isinstance(target, Path) or is_device(target):
        file = target.open("wb") if isinstance(target, Path) else target
        with errors_named(str(target) if isinstance(target, Path) else "standard output"):
            yield file, file.flush
    else:
        with GrowingFile(target, resumable=False) as growing:
            try:
                with errors_named(str(target)):
                    yield growing.file, growing.publish
            except BaseException:
                growing.discard()
                raise
