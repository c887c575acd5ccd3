"""A take while it is edited: a header, and frames that can be read again from any place."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.codec.corrections import Corrections
from decogs.codec.header import StreamHeader
from decogs.codec.state import State
from decogs.formats.callbacks import OnWarning
from decogs.formats.container import Packet, PacketKind
from decogs.formats.errors import StreamError
from decogs.formats.reasons import Reason

from ..frame import DecodedFrame
from ..frame_choice import open_chosen
from ..stream import Stream


@dataclass(frozen=True, eq=False)
class Coded:
    """A packet that was read: it takes ``before``, None at a keyframe, to ``after``.

    ``first``: the state of the first keyframe, where the packet refers to it.
    """

    packet: Packet
    before: State | None
    after: State
    first: State | None


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: its scene, under the ids that its source gave, and what cameras did to their pictures.

    ``is_key``: a segment begins here. ``coded``: a packet that may lead here, which saves coding another one.
    """

    state: State
    corrections: Corrections
    is_key: bool
    coded: Coded | None = None

    def of(self, state: State) -> Frame:
        """The same frame of another scene."""
        return replace(self, state=state)


Read = Callable[[int, int], Iterator[Frame]]
"""The frames from one number up to, not including, another."""

Note = Callable[[], str]
"""A line that says what an operation did; asked for once the take was read."""


@dataclass(frozen=True, eq=False)
class Take:
    """``frame_count`` frames, which ``read`` reads as often as it is called; ``header`` describes them as written.

    ``sources``: the files that are read on the way. ``notes``: what the operations so far have to say.
    """

    header: StreamHeader
    frame_count: int
    read: Read
    sources: tuple[Path, ...] = ()
    notes: tuple[Note, ...] = ()

    def with_note(self, note: Note | str) -> Take:
        """The same take with one more line to say."""
        return replace(self, notes=(*self.notes, (lambda: note) if isinstance(note, str) else note))

    def each(self, edit: Callable[[Frame], Frame]) -> Take:
        """The take with every frame edited by itself."""
        return replace(self, read=lambda start, stop: map(edit, self.read(start, stop)))


@contextmanager
def open_take(path: str | os.PathLike[str], *, max_memory: int, on_warning: OnWarning | None) -> Iterator[Take]:
    """A stream as a take. Reading a frame that is damaged raises StreamError; frames that are not read may be.

    Raises StreamError, OSError, and UsageError for a stream without a frame.
    """
    with open_chosen(path, None, strict=False, max_memory=max_memory, on_warning=on_warning) as (stream, every):
        yield Take(stream.header, len(every), lambda start, stop: _frames(stream, start, stop), (Path(path),))


def _frames(stream: Stream, start: int, stop: int) -> Iterator[Frame]:
    before: State | None = None
    for frame in stream.frames(start, stop):
        yield Frame(frame.state, frame.corrections, frame.kind == PacketKind.KEY, _coded(stream, frame, before))
        before = frame.state


def _coded(stream: Stream, frame: DecodedFrame, before: State | None) -> Coded | None:
    """None where the frame before was not read."""
    if frame.coded is None:
        raise StreamError(
            Reason.MISSING_KEY,
            f"{stream.path}: frame {frame.index} is damaged ({frame.concealed}); `trim` to frames that are not",
        )
    if frame.kind == PacketKind.KEY:
        return Coded(frame.coded, None, frame.state, stream.first_keyframe() if frame.refers_to_first else None)
    return None if before is None else Coded(frame.coded, before, frame.state, None)
