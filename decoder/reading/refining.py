"""The layers above a stream's base: where their packets lie, and a frame with all that they add."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from operator import attrgetter
from typing import BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.codec.layers import FirstKeyframe, LayeredScene, refine
from decogs.codec.packets.frame_payload import FramePayload
from decogs.codec.packets.refinement import Refinement, read_refinement
from decogs.codec.packets.syntax import refers_to_first
from decogs.codec.reconstruct import reconstruct_frame
from decogs.codec.scene.state import State
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import (
    IndexEntry,
    Packet,
    PacketKind,
    end_of_packet,
    read_packet_at,
    refinements_between,
)
from decogs.formats.stream.reasons import Reason
from decogs.formats.stream.survey import Survey

_UNKNOWN = 0
"""Stands for a layer that the stream has not."""
ALL, BASE = "all", "base"
"""Names of layers; others are numbers from 0, the base, on."""


def layer_number(name: str | int | None, header: StreamHeader) -> int:
    """The top layer that is asked for, as a number. Raises UsageError for one that the stream has not."""
    top = max(0, len(header.layers) - 1)
    if name in (None, ALL):
        return top
    number = {BASE: 0}.get(str(name), int(name) if str(name).isdecimal() else -1)
    if not 0 <= number <= top:
        there = f"it has {BASE}, {', '.join(map(str, range(1, top + 1)))}" if top else "it has one layer"
        raise UsageError(f"`layer` {name}: the stream has no such layer; {there}")
    return number


class Refiner:
    """Makes frames whole up to the layer ``top``; where packets lie is looked for a segment at a time."""

    def __init__(
        self, file: BinaryIO, header: StreamHeader, top: int, survey: Callable[[], Survey], *, max_payload: int
    ) -> None:
        self._file, self._header, self.top, self._survey = file, header, top, survey
        self._max_payload = max_payload
        self._segment, self._lies = range(0), dict[tuple[int, int], IndexEntry]()

    def refined(
        self,
        base: Packet,
        before: Sequence[State] | None,
        first: Callable[[], FirstKeyframe],
        max_gaussians: int,
    ) -> tuple[LayeredScene, tuple[int, ...]]:
        """The frame of a ``base`` packet, and the bytes of each of its refinements on disk.

        ``before``: the blocks of the frame before, None at a keyframe.

        ``first``: the first keyframe, asked for where one refers to it. Raises StreamError.
        """
        refinements = [self._refinement(base.frame, layer) for layer in range(1, self.top + 1)]
        there = [each.block for each in refinements if each is not None]
        known = first() if any(map(refers_to_first, (base, *there))) else None
        scene = refine(before, base, refinements, self._header, first=known, max_gaussians=max_gaussians)
        return scene, tuple(block.size for block in there)

    def first_keyframe(self, base: Packet, max_gaussians: int) -> FirstKeyframe:
        """That of the stream, whose packet of the ``base`` is read from behind its corrections. Raises StreamError."""
        refinements = [self._refinement(base.frame, layer) for layer in range(1, self.top + 1)]
        aligned = refine(None, base, refinements, self._header, max_gaussians=max_gaussians).blocks
        packets = [base, *(each.block for each in refinements if each is not None)]
        own = [
            reconstruct_frame(None, FramePayload({}, packet), self._header, max_gaussians=max_gaussians).state
            for packet in packets
        ]
        return FirstKeyframe(tuple(own), aligned)

    def _refinement(self, frame: int, layer: int) -> Refinement | None:
        lies = self._lies_of(frame)
        if (frame, _UNKNOWN) in lies:
            message = f"a refinement of frame {frame} is of no layer that there is"
            raise StreamError(Reason.BAD_PAYLOAD, message, offset=lies[frame, _UNKNOWN].offset)
        entry = lies.get((frame, layer))
        if entry is None:
            return None
        here = IndexEntry(entry.offset, frame, PacketKind.REFINE)
        return read_refinement(read_packet_at(self._file, here, max_payload=self._max_payload))

    def _lies_of(self, frame: int) -> Mapping[tuple[int, int], IndexEntry]:
        """Where the refinements of the frame's segment lie, by frame and layer; the first of several counts."""
        if frame not in self._segment:
            survey = self._survey()
            begin, following = survey.keyframe_before(frame + 1), survey.keyframe_after(frame)
            end = survey.frame_count if following is None else following
            self._segment, self._lies = range(begin or 0, end), {}
            last = survey.entries[bisect_left(survey.entries, end, key=attrgetter("frame")) - 1]
            after = None if following is None else survey.entry(following)
            start = end_of_packet(self._file, last.offset)
            for entry in refinements_between(self._file, start, None if after is None else after.offset):
                layer = entry.kind if 0 < entry.kind < len(self._header.layers) else _UNKNOWN
                self._lies.setdefault((entry.frame, layer), entry)
        return self._lies


def lost_refinement(error: StreamError, frame: int) -> StreamError:
    """The ``error`` as one of the layers above the base, with what a reader shows instead."""
    error.args = (f"{error}; from frame {frame} on the base alone is shown, up to the next keyframe",)
    return error
