"""The output of a part: its frames under their numbers in the part's own file."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.formats.stream.container import VERSION

from ..output.stream_output import StreamOutput, WrappedOutput, open_output
from .manifest import Part, read_part, with_part


def open_part(output: Path | BinaryIO) -> StreamOutput:
    """Opens the output of a part. A truncated one is replaced: it cannot be resumed."""
    return open_output(output, resumable=False, expendable=is_of_part)


def is_of_part(header: StreamHeader, frames: int) -> bool:
    """Whether a truncated stream is that of a part."""
    return read_part(header) is not None


class PartOutput(WrappedOutput):
    """Writes a whole stream's packets into the file of a part; ``inner`` takes them."""

    def __init__(self, inner: StreamOutput, part: Part) -> None:
        super().__init__(inner)
        self._part = part

    def begin(self, header: bytes, version: tuple[int, int] = VERSION) -> None:
        self._inner.begin(with_part(header, self._part), version)

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        return self._inner.write(kind, self._part.frame_in_part(frame), payload)
