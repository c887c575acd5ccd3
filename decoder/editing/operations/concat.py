"""``concat``: other streams behind this one."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.sound import SoundTrack
from decogs.formats.cli.command_line import Parser, counted

from ...sound.packets import FrameSound
from ..matching import matched
from ..take import Frame, Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Concat(Operation):
    """Appends the streams ``paths``, each a new segment with Gaussians of its own, of the same rig or another.

    Scenes keep their bits where lattice and SH degree are the first stream's, else they are rounded to its lattice.
    Tracks of sound go on with those of the same number, under the first stream's titles.
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

    def hear(start: int, stop: int) -> Iterator[FrameSound]:
        if start < begins:
            yield from first.hear(start, min(stop, begins))
        if stop > begins:
            yield from second.hear(max(0, start - begins), stop - begins)

    header = replace(header, sound=_tracks(first.header.sound, second.header.sound))
    starts = (*first.starts, *(begins + start for start in second.starts))
    return replace(first, header=header, frame_count=whole, read=read, hear=hear, starts=starts)


def _tracks(one: tuple[SoundTrack, ...], other: tuple[SoundTrack, ...]) -> tuple[SoundTrack, ...]:
    """Those of both, one after the other; a decoder makes stereo of a block of one channel."""
    both = zip_longest(one, other)
    return tuple(
        replace(first or second, channels=max(track.channels for track in (first, second) if track))
        for first, second in both
    )
