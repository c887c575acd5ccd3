"""``merge``: another take in the same scene at the same time."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from decogs.codec.packets.corrections import Corrections
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.state import State, all_rows, join_rows, same_scene, take_rows
from decogs.formats.cli.command_line import Parser, counted

from ...sound.packets import FrameSound
from ..matching import matched
from ..sound import renumbered
from ..take import Frame, Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Merge(Operation):
    """Brings the Gaussians of the stream ``path`` into every frame, where that stream's transform says.

    Ids are apart. Tracks of sound are played together. The result is as long as the shorter of the two.
    """

    path: Path
    name = "merge"
    summary = "bring another take into the scene"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """Both takes at once. Raises UsageError for streams that do not go together."""
        both = matched(self.name, take, open_other(self.path))
        count = min(take.frame_count, both.second.frame_count)

        def read(start: int, stop: int) -> Iterator[Frame]:
            before: tuple[State, State, State, State | None] | None = None
            for one, other in zip(both.first.read(start, stop), both.second.read(start, stop), strict=True):
                if before is None or not (same_scene(before[0], one.state) and same_scene(before[1], other.state)):
                    base = None if one.base is None or other.base is None else _together(one.base, other.base)
                    before = one.state, other.state, _together(one.state, other.state), base
                corrections: Corrections = {**other.corrections, **one.corrections}
                yield replace(one, state=before[2], base=before[3], corrections=corrections)

        def hear(start: int, stop: int) -> Iterator[FrameSound]:
            others = renumbered(both.second.hear, len(take.header.sound))
            return (one + other for one, other in zip(both.first.hear(start, stop), others(start, stop), strict=True))

        starts = tuple(start for start in take.starts if start < count)
        header = replace(both.header, sound=(*take.header.sound, *both.second.header.sound))
        merged = replace(both.first, header=header, frame_count=count, read=read, hear=hear, starts=starts)
        cost = f" ({both.cost})" if both.cost else ""
        return merged.with_note(f"merge: {self.path}, {counted(count, 'frame')}{cost}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The stream."""
        parser.add_argument("path", type=Path, metavar="OTHER.DGS", help="the other stream")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Merge:
        """Of the stream as it is named."""
        return cls(options.path)


def _together(one: State, other: State) -> State:
    """Both scenes' Gaussians; ids of the second are above those of the first, as takes are numbered."""
    ids = np.concatenate([one.ids, other.ids])
    attributes = join_rows(all_rows(one), all_rows(other))
    order = np.argsort(ids)  # where the first was merged before, another take's come between
    if (order[1:] < order[:-1]).any():
        attributes, ids = take_rows(attributes, order), ids[order]
    return new_state(attributes, one.frame, ids=ids, next_id=max(one.next_id, other.next_id))
