"""A stream that comes through a pipe, kept in a file of its own so that a browser can ask for any part of it."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.formats.files.outputs import part_of

from ..reading.following import follow_stream

NAME = "stream.dgs"
"""Of the file, and of its address."""
_CHUNK = 1 << 16


class PipedStream:
    """The file ``path``, which grows as the stream comes, and its ``header``; ``close`` removes it.

    Raises StreamError where the pipe holds no stream.
    """

    def __init__(self, pipe: BinaryIO) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="decogs-")
        self.path = Path(self._folder.name) / NAME
        self.error: OSError | None = None
        self._source = _Copied(pipe, part_of(self.path))
        try:
            with follow_stream(self._source) as stream:  # type: ignore[arg-type]
                self.header: StreamHeader = stream.header
        except BaseException:
            self._source.close()
            self.close()
            raise

    def go_on(self, when_failed: Callable[[], None]) -> None:
        """Takes what else comes, on a thread of its own; ``error`` says why ``when_failed`` was called."""
        threading.Thread(target=self._take, args=(when_failed,), name="decogs-pipe", daemon=True).start()

    def close(self) -> None:
        """Removes the file; closing twice does no harm."""
        self._folder.cleanup()

    def __enter__(self) -> PipedStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _take(self, when_failed: Callable[[], None]) -> None:
        try:
            while self._source.take():
                pass
            os.replace(part_of(self.path), self.path)
        except OSError as error:
            if self.path.parent.exists():  # not closed meanwhile
                self.error = error
                when_failed()
        finally:
            self._source.close()


class _Copied:
    """A pipe whose bytes are written into a file as they are read."""

    def __init__(self, pipe: BinaryIO, file: Path) -> None:
        self._pipe, self._file = _unbuffered(pipe), file.open("wb", buffering=0)

    def take(self, most: int = _CHUNK) -> bytes:
        """What is there, at least a byte; none at the end."""
        data = self._pipe.read(most)
        self._file.write(data)
        return data

    def read(self, size: int) -> bytes:
        """As many bytes as are asked for, fewer only at the end."""
        taken = b""
        while len(taken) < size and (data := self.take(size - len(taken))):
            taken += data
        return taken

    def close(self) -> None:
        """Closes the file, and nothing that was given."""
        self._file.close()


def _unbuffered(pipe: BinaryIO) -> BinaryIO:
    """The same pipe without a lock, which a thread that waits for bytes would hold when Python ends."""
    try:
        return open(pipe.fileno(), "rb", buffering=0, closefd=False)
    except OSError:  # it lies in memory
        return pipe
