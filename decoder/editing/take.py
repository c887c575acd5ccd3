"""A take while it is edited: a header, and frames that can be read again from any place."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Corrections
from decogs.codec.scene.state import State, same_scene
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import Packet, PacketKind
from decogs.formats.stream.reasons import Reason
from decogs.formats.system.callbacks import OnWarning

from ..frame_choice import open_chosen
from ..reading.frame import DecodedFrame
from ..reading.stream import Stream
from ..sound.packets import FrameSound
from .names import OWN_IDS


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

    No two takes of an edit have an id in common; hashes of the state need not fit its ids.
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

SoundReader = Callable[[int, int], Iterator[FrameSound]]
"""The sound of frames from one number up to, not including, another; right after `frames_before` others."""

Note = Callable[[], str]
"""A line that says what an operation did; asked for once the take was read."""


def silence(start: int, stop: int) -> Iterator[FrameSound]:
    """No sound in any frame."""
    return repeat((), stop - start)


@dataclass(frozen=True, eq=False)
class Take:
    """``frame_count`` frames, which ``read`` reads as often as it is called; ``header`` describes them as written.

    ``hear`` gives the frames' sound, as ``read`` does the frames.
    ``starts``: the frames at which segments begin, of which 0 is the first. ``sources``: the files that are read on the
    way. ``notes``: what the operations so far have to say.
    """

    header: StreamHeader
    frame_count: int
    read: Read
    hear: SoundReader = silence
    starts: tuple[int, ...] = (0,)
    sources: tuple[Path, ...] = ()
    notes: tuple[Note, ...] = ()

    def with_note(self, note: Note | str) -> Take:
        """The same take with one more line to say."""
        return replace(self, notes=(*self.notes, (lambda: note) if isinstance(note, str) else note))

    def with_poster(self, poster_of: Callable[[int], int | None]) -> Take:
        """The take with its poster where that frame is now; None where it is no more."""
        presentation = self.header.presentation
        if presentation.poster is None:
            return self
        return replace(
            self, header=replace(self.header, presentation=replace(presentation, poster=poster_of(presentation.poster)))
        )

    def each_scene(self, edit: Callable[[State], State]) -> Take:
        """The take with the scene of every frame edited by itself; one that did not change is edited once."""

        def read(start: int, stop: int) -> Iterator[Frame]:
            before = after = None
            for frame in self.read(start, stop):
                if before is None or after is None or not same_scene(before, frame.state):
                    after = edit(frame.state)
                before = frame.state
                yield frame.of(after)

        return replace(self, read=read)

    def each(self, edit: Callable[[Frame], Frame]) -> Take:
        """The take with every frame edited by itself."""
        return replace(self, read=lambda start, stop: map(edit, self.read(start, stop)))


_NAMED = 20

_OF_THE_ENCODE = ("part", "recorded")
"""Settings from which an encode would go on (``encoder.parts``, ``encoder.input.recordings``), which no edit is."""


@contextmanager
def open_take(
    path: str | os.PathLike[str], number: int, *, max_memory: int, on_warning: OnWarning | None
) -> Iterator[Take]:
    """A stream as the take of this ``number``, from 0. Reading a frame that is damaged raises StreamError.

    Raises StreamError, OSError, and UsageError for a stream without a frame.
    """
    with open_chosen(path, None, strict=False, max_memory=max_memory, on_warning=on_warning) as (stream, every):
        if on_warning is not None and (lost := stream.unknown_parts()):
            on_warning(f"{path}: holds what this version does not know, which is left out: {', '.join(lost[:_NAMED])}")
        settings = {name: value for name, value in stream.stored_header.settings.items() if name not in _OF_THE_ENCODE}
        source = _Source(stream, number * OWN_IDS)
        header = replace(stream.stored_header, settings=settings)
        # The first keyframe of a damaged stream may be none that is left.
        starts = (0, *(frame for frame in stream.keyframes if frame))
        yield Take(header, len(every), source.read, stream.sounds, starts, (Path(path),))


@dataclass(frozen=True, eq=False)
class _Source:
    """A stream whose ids are counted from a place of their own, that of no other stream of the edit."""

    stream: Stream
    first_id: int

    def read(self, start: int, stop: int) -> Iterator[Frame]:
        was: DecodedFrame | None = None
        before: State | None = None
        for frame in self.stream.frames(start, stop):
            same_ids = before if was is not None and was.state.ids is frame.state.ids else None
            after = self._renumbered(frame.state, same_ids)
            is_key = frame.kind == PacketKind.KEY
            yield Frame(after, frame.corrections, is_key, self._coded(frame, None if is_key else before, after))
            was, before = frame, after

    def _renumbered(self, state: State, same_ids: State | None = None) -> State:
        if not self.first_id:
            return state
        if state.next_id > OWN_IDS:
            raise UsageError(f"{self.stream.path}: has ids above 2^52, which do not go with another take's")
        ids = state.ids + self.first_id if same_ids is None else same_ids.ids
        return replace(state, ids=ids, next_id=state.next_id + self.first_id)

    def _coded(self, frame: DecodedFrame, before: State | None, after: State) -> Coded | None:
        """None for a delta from a frame that was not read."""
        if frame.coded is None:
            raise StreamError(
                Reason.MISSING_KEY,
                f"{self.stream.path}: frame {frame.index} is damaged ({frame.concealed}); trim it away",
            )
        if frame.kind != PacketKind.KEY and before is None:
            return None
        first = self._renumbered(self.stream.first_keyframe()) if frame.refers_to_first else None
        return Coded(frame.coded, before, after, first)
