"""``concat``: other streams behind this one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.codec.header import StreamHeader
from decogs.formats.command_line import Parser, counted

from ..matching import matched
from ..take import Frame, Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Concat(Operation):
    """Appends the streams ``paths``, each a new segment with Gaussians of its own, of the same rig or another.

    Scenes keep their bits where lattice and SH degree are the first stream's, else they are rounded to its lattice.
    """

    paths: tuple[Path, ...]
    name = "concat"
    summary = "append other streams"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """All frames, one take after the other. Raises UsageError for streams that do not go together."""
        for path in self.paths:
            other = open_other(path)
            both = matched(self.name, take, other)
            cost = f" ({both.cost})" if both.cost else ""
            note = f"concat: {path}, {counted(other.frame_count, 'frame')}{cost}"
            take = _joined(both.header, both.first, both.second).with_note(note)
        return take

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The streams."""
        parser.add_argument("paths", nargs="+", type=Path, metavar="MORE.DGS", help="one or more streams")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Concat:
        """Of the streams as they are named."""
        return cls(tuple(options.paths))


def _joined(header: StreamHeader, first: Take, second: Take) -> Take:
    whole, begins = first.frame_count + second.frame_count, first.frame_count

    def read(start: int, stop: int) -> Iterator[Frame]:
        if start < begins:
            yield from first.read(start, min(stop, begins))
        if stop > begins:
            behind = second.read(max(0, start - begins), stop - begins)
            for number, frame in enumerate(behind, start=max(start, begins)):
                yield replace(frame, is_key=True) if number == begins else frame

    starts = (*first.starts, *(begins + start for start in second.starts))
    return replace(first, header=header, frame_count=whole, read=read, starts=starts)
