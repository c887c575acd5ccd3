"""Where a stream is written while it grows: beside its final name, or straight into a pipe.

A file grows as ``NAME.part`` and gets its name when it is whole; what was complete when something went wrong stays in
``NAME.part``, a valid, shorter stream that ``--resume`` goes on with (`resuming`).
"""

from __future__ import annotations

import os
import shutil
from abc import ABC, abstractmethod
from pathlib import Path
from typing import BinaryIO

from decogs.formats.container import StreamWriter
from decogs.formats.errors import UsageError

from .resuming import Interrupted


class StreamOutput(ABC):
    """Takes a stream's packets: ``begin``, ``write`` for each, then ``close``, and ``publish`` when all went well."""

    def __init__(self) -> None:
        self.writer: StreamWriter | None = None

    @property
    @abstractmethod
    def name(self) -> Path:
        """What the user called it; ``-`` is a pipe."""

    @property
    def is_open(self) -> bool:
        """Whether anything was changed yet."""
        return self.writer is not None

    @abstractmethod
    def begin(self, header: bytes) -> None:
        """Starts a new stream with this header payload."""

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        """Appends one packet and returns its size in bytes."""
        return self.open().write(kind, frame, payload)

    def open(self) -> StreamWriter:
        """The writer, which must have begun."""
        assert self.writer is not None
        return self.writer

    @abstractmethod
    def close(self, frames: int) -> None:
        """Ends the stream after its first ``frames``, with its index; without any, nothing is left of it."""

    def publish(self) -> int:
        """Gives the stream its name; its size in bytes."""
        return self.open().bytes_written


class FileOutput(StreamOutput):
    """A file. ``left``: what an earlier encode left of it, gone on with at the first packet after it."""

    def __init__(self, output: Path, left: Interrupted | None = None) -> None:
        """Raises UsageError for what cannot be written: training takes minutes, it must be said before."""
        super().__init__()
        _check(output)
        self._output, self._left = output, left
        self.growing = part_of(output)
        self._file: BinaryIO | None = None

    @property
    def name(self) -> Path:
        return self._output

    def begin(self, header: bytes) -> None:
        self._file = self.growing.open("wb")
        self.writer = StreamWriter(self._file, header)

    def open(self) -> StreamWriter:
        if self.writer is None and self._left is not None:
            if self._left.path != self.growing:
                shutil.copyfile(self._left.path, self.growing)
            self._file = self.growing.open("r+b")
            self._file.truncate(self._left.size)
            self._file.seek(self._left.size)
            self.writer = StreamWriter.continuing(self._file, self._left.entries, self._left.size)
        return super().open()

    def close(self, frames: int) -> None:
        if self._file is None:
            return
        if frames and self.writer is not None:
            _cut_after(frames, self._file, self.writer)
            self.writer.finish()
        self._file.close()
        if not frames:
            self.growing.unlink(missing_ok=True)

    def publish(self) -> int:
        os.replace(self.growing, self._output)
        return super().publish()


class PipeOutput(StreamOutput):
    """A pipe, or any other file that only takes bytes; what was interrupted inside a packet cannot be mended."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__()
        self._file = file

    @property
    def name(self) -> Path:
        return Path("-")

    def begin(self, header: bytes) -> None:
        self.writer = StreamWriter(self._file, header)

    def close(self, frames: int) -> None:
        if self.writer is not None and len(self.writer.entries) == frames > 0:
            self.writer.finish()


def part_of(output: Path) -> Path:
    """The file that a stream grows in."""
    return output.with_name(output.name + ".part")


def _check(output: Path) -> None:
    if output.is_dir():
        raise UsageError(f"{output}: is a folder; name a file in it, such as {output / 'scene.dgs'}")
    if not output.parent.is_dir():
        raise UsageError(f"{output.parent}: no such folder; create it first")
    if not os.access(output.parent, os.W_OK):
        raise UsageError(f"{output.parent}: cannot be written to; choose another folder")


def _cut_after(frames: int, file: BinaryIO, writer: StreamWriter) -> None:
    """Takes off what an interruption left, in whole or in part, of a packet after the first ``frames``."""
    if len(writer.entries) > frames:
        end = writer.entries[frames].offset
        file.seek(end)
        file.truncate()
        del writer.entries[frames:]
        writer.bytes_written = end
