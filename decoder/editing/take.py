"""A take while it is edited: a header, and frames that can be read again from any place."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from itertools import repeat
from pathlib import Path

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.profiles import NO_PROFILE
from decogs.codec.packets.corrections import Corrections
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.state import ARRAYS, Attributes, State, all_rows, part_of, same_scene, take_rows
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import Packet, PacketKind
from decogs.formats.stream.reasons import Reason
from decogs.formats.system.callbacks import OnWarning

from ..frame_choice import open_chosen
from ..reading.frame import DecodedFrame
from ..reading.refining import BASE
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
    ``is_key``: a segment begins here. ``coded``: a packet that may lead here, which saves coding another one. ``base``:
    in a take of layers, some of the scene's Gaussians with the values that they have alone.
    """

    state: State
    corrections: Corrections
    is_key: bool
    coded: Coded | None = None
    base: State | None = None

    def of(self, state: State) -> Frame:
        """The same frame of another scene; what of its base is left differs from it as before."""
        base = self.base
        if base is not None and not same_scene(self.state, state):
            base = carried_over(base, self.state, state)
        return replace(self, state=state, base=base)


Read = Callable[[int, int], Iterator[Frame]]
"""The frames from one number up to, not including, another."""

SoundReader = Callable[[int, int], Iterator[FrameSound]]
"""The sound of frames from one number up to, not including, another; right after `frames_before` others."""

Note = Callable[[], str]
"""A line that says what an operation did; asked for once the take was read."""


def silence(start: int, stop: int) -> Iterator[FrameSound]:
    """No sound in any frame."""
    return repeat((), stop - start)


def carried_over(base: State, before: State, after: State) -> State:
    """What is left of a ``base`` in the whole scene ``after``, as far from its values there as it was ``before``."""
    stays = np.isin(base.ids, after.ids, assume_unique=True)
    own = part_of(base, stays)
    was, now = (take_rows(scene, np.searchsorted(scene.ids, own.ids)) for scene in (before, after))
    moved = {name: getattr(now, name) - getattr(was, name) for name in ARRAYS}
    if not any(change.any() for change in moved.values()):
        return own
    values = Attributes(**{name: getattr(all_rows(own), name) + moved[name] for name in ARRAYS})
    return new_state(values, after.frame, ids=own.ids, next_id=own.next_id)


@dataclass(frozen=True, eq=False)
class Take:
    """``frame_count`` frames, which ``read`` reads as often as it is called; ``header`` describes them as written.

    ``hear`` gives the frames' sound, as ``read`` does the frames.
    ``starts``: the frames at which segments begin, of which 0 is the first. ``sources``: the files that are read on the
    way. ``notes``: what the operations so far have to say. ``profile``: that which its base must keep within; empty
    where the header is only to say which one it does, None where it says nothing of that. ``threads``: that operations
    may use, 0 for all processors.
    """

    header: StreamHeader
    frame_count: int
    read: Read
    hear: SoundReader = silence
    starts: tuple[int, ...] = (0,)
    sources: tuple[Path, ...] = ()
    notes: tuple[Note, ...] = ()
    profile: str | None = None
    threads: int = 0

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
            before = after = base = None
            for frame in self.read(start, stop):
                if before is None or after is None or not same_scene(before, frame.state):
                    after = edit(frame.state)
                    base = None if frame.base is None else edit(frame.base)
                before = frame.state
                yield replace(frame, state=after, base=base)

        return replace(self, read=read)

    def without_layers(self) -> Take:
        """The take with its whole scenes in one layer."""
        plain = self.each(lambda frame: replace(frame, base=None)) if self.header.layers else self
        return replace(plain, header=replace(self.header, layers=()))

    def each(self, edit: Callable[[Frame], Frame]) -> Take:
        """The take with every frame edited by itself."""
        return replace(self, read=lambda start, stop: map(edit, self.read(start, stop)))


_NAMED = 20


@contextmanager
def open_take(
    path: str | os.PathLike[str], number: int, *, max_memory: int, on_warning: OnWarning | None
) -> Iterator[Take]:
    """A stream as the take of this ``number``, from 0. Reading a frame that is damaged raises StreamError.

    Raises StreamError, OSError, and UsageError for a stream without a frame.
    """
    with ExitStack() as opened:

        def opened_at(layer: str | None, on_warning: OnWarning | None) -> tuple[Stream, range]:
            return opened.enter_context(
                open_chosen(path, None, strict=False, max_memory=max_memory, on_warning=on_warning, layer=layer)
            )

        stream, every = opened_at(None, on_warning)
        base = opened_at(BASE, None)[0] if stream.header.layers else None
        if on_warning is not None and (lost := stream.unknown_parts()):
            on_warning(f"{path}: holds what this version does not know, which is left out: {', '.join(lost[:_NAMED])}")
        stored = stream.stored_header
        source = _Source(stream, base, number * OWN_IDS)
        # What is between the base and the whole becomes part of what makes it whole.
        header = replace(stored, layers=stored.layers[:1] + stored.layers[-1:], profiles=())
        profile = NO_PROFILE if stored.profiles else None
        # The first keyframe of a damaged stream may be none that is left.
        starts = (0, *(frame for frame in stream.keyframes if frame))
        yield Take(header, len(every), source.read, stream.sounds, starts, (Path(path),), profile=profile)


@dataclass(frozen=True, eq=False)
class _Source:
    """A stream whose ids are counted from a place of their own, that of no other stream of the edit.

    ``base``: the same stream read up to its base alone, where it has layers.
    """

    stream: Stream
    base: Stream | None
    first_id: int

    def read(self, start: int, stop: int) -> Iterator[Frame]:
        was: DecodedFrame | None = None
        before: State | None = None
        bases = self._bases(start, stop)
        for frame in self.stream.frames(start, stop):
            self._check(frame, lacks_layers=self.base is not None and frame.blocks is None)
            same_ids = before if was is not None and was.state.ids is frame.state.ids else None
            after = self._renumbered(frame.state, same_ids)
            is_key = frame.kind == PacketKind.KEY
            coded = self._coded(frame, None if is_key else before, after)
            yield Frame(after, frame.corrections, is_key, coded, next(bases))
            was, before = frame, after

    def _renumbered(self, state: State, same_ids: State | None = None) -> State:
        if not self.first_id:
            return state
        if state.next_id > OWN_IDS:
            raise UsageError(f"{self.stream.path}: has ids above 2^52, which do not go with another take's")
        ids = state.ids + self.first_id if same_ids is None else same_ids.ids
        return replace(state, ids=ids, next_id=state.next_id + self.first_id)

    def _bases(self, start: int, stop: int) -> Iterator[State | None]:
        if self.base is None:
            return repeat(None, stop - start)
        return map(self._base_of, self.base.frames(start, stop))

    def _base_of(self, frame: DecodedFrame) -> State:
        self._check(frame)
        return self._renumbered(frame.state)

    def _check(self, frame: DecodedFrame, *, lacks_layers: bool = False) -> None:
        """Raises StreamError for a frame that is damaged, or of which layers are."""
        if frame.concealed is not None or lacks_layers:
            why = "" if frame.concealed is None else f" ({frame.concealed})"
            message = f"{self.stream.path}: frame {frame.index} is damaged{why}; trim it away"
            raise StreamError(Reason.MISSING_KEY, message)

    def _coded(self, frame: DecodedFrame, before: State | None, after: State) -> Coded | None:
        """None for a delta from a frame that was not read, and for a frame of layers, to which no one packet leads."""
        if frame.coded is None or (frame.kind != PacketKind.KEY and before is None):
            return None
        first = self._renumbered(self.stream.first_keyframe()) if frame.refers_to_first else None
        return Coded(frame.coded, before, after, first)
