"""Where a stream is written while it grows: beside its final name, or straight into a pipe.

A file grows as ``NAME.part``, which no other encode can write meanwhile, and gets its name when it is whole
(`formats.files.outputs`); what was complete when something went wrong stays in ``NAME.part``, a valid, shorter stream
that ``resume`` goes on with (`resume`).
"""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from decogs.formats.errors import TryAgainError, UsageError
from decogs.formats.files.outputs import Expendable, GrowingFile, Leftover, errors_named, is_device
from decogs.formats.stream.container import VERSION, StreamWriter

from .resume import Interrupted, IsSuch, find_interrupted, is_expendable


class StreamOutput(ABC):
    """The output of a stream: ``begin``, ``write`` for each packet, ``close``, and ``publish`` when it is complete.

    A context manager: leaving it lets go of the file.
    """

    def __init__(self) -> None:
        self.writer: StreamWriter | None = None

    def __enter__(self) -> StreamOutput:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()

    @property
    @abstractmethod
    def name(self) -> Path:
        """Its name as the user gave it; ``-`` is a pipe."""

    @property
    def is_open(self) -> bool:
        """Whether anything was changed yet."""
        return self.writer is not None

    @property
    def growing(self) -> Path | None:
        """The file that keeps the frames of an encode that ends early; None for a pipe."""
        return None

    @abstractmethod
    def begin(self, header: bytes, version: tuple[int, int] = VERSION) -> None:
        """Starts a new stream with this header payload."""

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        """Appends one packet and returns its size in bytes."""
        return self.open().write(kind, frame, payload)

    def open(self) -> StreamWriter:
        """The writer, which must have begun."""
        assert self.writer is not None
        return self.writer

    def cut(self, frames: int) -> bool:
        """Takes back what lies behind the first ``frames``, where it can; whether anything can still be written."""
        return True

    @abstractmethod
    def close(self, frames: int) -> None:
        """Ends the stream after its first ``frames``, with its index; without any, nothing is left of it."""

    def publish(self) -> int:
        """Gives the stream its name; its size in bytes."""
        return self.open().bytes_written

    @abstractmethod
    def release(self) -> None:
        """Lets go of the file, published or not."""


class WrappedOutput(StreamOutput):
    """Does as ``inner`` does; a subclass changes what is written into it."""

    def __init__(self, inner: StreamOutput) -> None:
        super().__init__()
        self._inner = inner

    @property
    def name(self) -> Path:
        return self._inner.name

    @property
    def is_open(self) -> bool:
        return self._inner.is_open

    @property
    def growing(self) -> Path | None:
        return self._inner.growing

    def begin(self, header: bytes, version: tuple[int, int] = VERSION) -> None:
        self._inner.begin(header, version)

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        return self._inner.write(kind, frame, payload)

    def open(self) -> StreamWriter:
        return self._inner.open()

    def cut(self, frames: int) -> bool:
        return self._inner.cut(frames)

    def close(self, frames: int) -> None:
        self._inner.close(frames)

    def publish(self) -> int:
        return self._inner.publish()

    def release(self) -> None:
        self._inner.release()


class FileOutput(StreamOutput):
    """A file, locked from now on, so that one that cannot be written is refused before training.

    ``resume``: a ``NAME.part`` that is there is continued; ``expendable``: it is replaced if it is such a stream, or
    has no whole header. Raises UsageError when it exists otherwise, when it cannot be written, or is being written by
    another encode; so does every method when the disk is full. ``resumable``: whether errors propose `resume`.
    """

    def __init__(
        self,
        output: Path,
        *,
        resume: bool = False,
        resumable: bool = True,
        expendable: IsSuch | None = None,
    ) -> None:
        super().__init__()
        self._output, self._resumable = output, resumable
        leftover: Leftover | Expendable = "kept" if resume else "refused"
        if expendable is not None:
            leftover = partial(is_expendable, expendable)
        self._growing = GrowingFile(output, leftover=leftover, resumable=resumable)
        self._left: Interrupted | None = None
        self._failed = False

    @property
    def name(self) -> Path:
        return self._output

    @property
    def growing(self) -> Path:
        return self._growing.path

    def take_left(self) -> Interrupted | None:
        """The part that an earlier encode left, which the next packet continues."""
        self._left = find_interrupted(self._growing.output, self.growing)
        return self._left

    def begin(self, header: bytes, version: tuple[int, int] = VERSION) -> None:
        with self._disk_errors():
            file = self._growing.file
            file.seek(0)
            file.truncate()
            self.writer = StreamWriter(file, header, version)

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        with self._disk_errors():
            return super().write(kind, frame, payload)

    def open(self) -> StreamWriter:
        left, file = self._left, self._growing.file
        if self.writer is None and left is not None:
            with self._disk_errors():
                if left.path != self.growing:
                    with left.path.open("rb") as published:
                        shutil.copyfileobj(published, file)
                file.truncate(left.size)
                file.seek(left.size)
                self.writer = StreamWriter.continuing(file, left.entries, left.size)
        return super().open()

    def cut(self, frames: int) -> bool:
        if self.writer is None or self._failed:
            return False
        with self._disk_errors():
            _cut_after(frames, self._growing.file, self.writer)
        return True

    def close(self, frames: int) -> None:
        if self.writer is None:
            return
        if not frames:
            self._growing.discard()
        elif self.cut(frames):
            with self._disk_errors():
                self.writer.finish()

    def publish(self) -> int:
        with self._disk_errors():
            self._growing.publish()
        return super().publish()

    def release(self) -> None:
        self._growing.release()

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        """Turns an error of the disk into one line with the file and the remedy."""
        try:
            yield
        except OSError as error:
            self._failed = True
            then = "then continue with `resume`" if self._resumable else "or name a file elsewhere"
            raise TryAgainError(f"{self.growing}: {error.strerror}; free space, {then}") from error


class PipeOutput(StreamOutput):
    """A pipe, or any other file that only takes bytes; a packet cut off in the middle cannot be completed."""

    def __init__(self, file: BinaryIO, name: Path = Path("-")) -> None:
        super().__init__()
        self._file, self._name = file, name

    @property
    def name(self) -> Path:
        return self._name

    def begin(self, header: bytes, version: tuple[int, int] = VERSION) -> None:
        with self._named:
            self.writer = StreamWriter(self._file, header, version)

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        with self._named:
            return super().write(kind, frame, payload)

    def close(self, frames: int) -> None:
        if self.writer is not None and len(self.writer.entries) == frames > 0:
            with self._named:
                self.writer.finish()

    def release(self) -> None:
        if self._name != Path("-"):
            with self._named:
                self._file.close()

    @property
    def _named(self) -> AbstractContextManager[None]:
        return errors_named("standard output" if self._name == Path("-") else str(self._name))


def open_output(
    output: Path | BinaryIO,
    *,
    resume: bool = False,
    resumable: bool = True,
    expendable: IsSuch | None = None,
) -> StreamOutput:
    """Takes the output of an encode, before anything long is done; a named pipe is written into as it is.

    Raises UsageError as `FileOutput` does, and when ``resume`` asks for what no pipe can.
    """
    if isinstance(output, Path) and not is_device(output):
        return FileOutput(output, resume=resume, resumable=resumable, expendable=expendable)
    if resume:
        raise UsageError("`resume`: a pipe cannot be resumed; name a file with `output`")
    if not (isinstance(output, Path) or hasattr(output, "write")):
        raise UsageError(f"`output` {output!r}: give a file's name, or an open file")
    return PipeOutput(output.open("wb"), output) if isinstance(output, Path) else PipeOutput(output)


def _cut_after(frames: int, file: BinaryIO, writer: StreamWriter) -> None:
    """Truncates a file after its first ``frames``."""
    if len(writer.entries) > frames:
        end = writer.entries[frames].offset
        file.seek(end)
        file.truncate()
        del writer.entries[frames:]
        writer.refinements = [entry for entry in writer.refinements if entry.offset < end]
        writer.bytes_written = end
