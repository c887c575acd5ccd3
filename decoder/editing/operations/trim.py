"""``trim``: a range of the frames."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError
from decogs.formats.frames.ranges import Frames, frame_range, frame_slice

from ..sound import from_frame
from ..take import Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Trim(Operation):
    """Keeps ``frames``, a slice by Python's rules or a range. Every scene keeps its bits, and ids stay.

    The first frame becomes a keyframe; packets that follow are taken as they are, but for keyframes that referred to a
    first one which is gone. Sound is cut to the sample, and keeps its bits.
    """

    frames: Frames
    name = "trim"
    summary = "keep a range of frames"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The chosen frames. Raises UsageError where the take has none of them."""
        asked = frame_slice(self.frames)
        start, stop, step = asked.indices(take.frame_count)
        if step != 1 or start >= stop:
            raise UsageError(
                f"trim: none of its {take.frame_count} frames is kept; choose some of 0:{take.frame_count}"
            )
        header = replace(take.header, first_frame=take.header.first_frame + start)
        trimmed = replace(
            take,
            header=header,
            frame_count=stop - start,
            read=lambda a, b: take.read(start + a, start + b),
            hear=from_frame(take, start),
            starts=(0, *(key - start for key in take.starts if start < key < stop)),
        )
        trimmed = trimmed.with_poster(lambda frame: frame - start if start <= frame < stop else None)
        return trimmed.with_note(f"trim: frames {start}:{stop} of {take.frame_count}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The range."""
        parser.add_argument("frames", metavar="A:B", help="half-open, as in Python: 0:10, 5:, -3:")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Trim:
        """Of the range as it was written."""
        return cls(frame_range(options.frames))
