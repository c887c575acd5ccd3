"""Where the frames of a stream lie: from its index, from its packet headers, or by searching past damage."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise

from ..errors import StreamError
from .container import FRAME_KINDS, IndexEntry, Packet, PacketKind, PacketReader, end_fields
from .reasons import DAMAGE, Reason

MAX_LOST_FRAMES = 1 << 16
"""How many frames may be missing from a stream in all: a few bytes must not be able to claim millions."""

_MIN_LOST, _LOST_FOR_EACH = 1 << 10, 1 << 6
"""What a stream may miss whatever is found of it, and besides for each frame that is: a file of a few frames must not
be able to claim hours of pictures that all show the same."""

MAX_DAMAGED_PLACES = 1 << 12
"""How many damaged places are searched past before a file counts as no stream at all."""


@dataclass(frozen=True)
class Survey:
    """The frames of a stream, and its damage as far as packet headers show it.

    ``entries``: the frame packets there are, frame indices rising; a frame below ``frame_count`` without an entry is
    lost. ``complete``: whether the stream was finished. ``unfinished_bytes``: those of an incomplete packet at the
    tail. ``damage``: what is wrong, offsets rising.
    """

    entries: tuple[IndexEntry, ...]
    frame_count: int
    complete: bool
    unfinished_bytes: int = 0
    damage: tuple[StreamError, ...] = ()

    def entry(self, frame: int) -> IndexEntry | None:
        """Where the packet of a frame lies; None when it is lost."""
        index = self._index(frame)
        exists = index < len(self.entries) and self.entries[index].frame == frame
        return self.entries[index] if exists else None

    def keyframe_before(self, frame: int) -> int | None:
        """The last keyframe before ``frame``, None when there is none."""
        indices = range(self._index(frame) - 1, -1, -1)
        return next((self.entries[i].frame for i in indices if self.entries[i].kind == PacketKind.KEY), None)

    def keyframe_after(self, frame: int) -> int | None:
        """The first keyframe after ``frame``, None when there is none."""
        indices = range(self._index(frame + 1), len(self.entries))
        return next((self.entries[i].frame for i in indices if self.entries[i].kind == PacketKind.KEY), None)

    def cause(self, frame: int) -> StreamError:
        """What is wrong where the packet of a lost frame should lie."""
        index = self._index(frame)
        low = self.entries[index - 1].offset if index else 0
        high = self.entries[index].offset if index < len(self.entries) else None
        first = bisect_left(self.damage, low, key=_offset)
        if first < len(self.damage) and (high is None or _offset(self.damage[first]) < high):
            return self.damage[first]
        return StreamError(Reason.FRAME_ORDER, f"the packet of frame {frame} is missing", offset=high)

    def harmless(self) -> Iterable[StreamError]:
        """The damage that costs no frame."""
        befores = [-1, *(entry.frame for entry in self.entries)]
        afters = [*(entry.frame for entry in self.entries), self.frame_count]
        gaps = [before + 1 for before, after in zip(befores, afters, strict=True) if after > before + 1]
        causes = {id(self.cause(frame)) for frame in gaps}
        return (error for error in self.damage if id(error) not in causes)

    def _index(self, frame: int) -> int:
        if 0 <= frame < len(self.entries) and self.entries[frame].frame == frame:
            return frame  # none is lost before it
        return bisect_left(self.entries, frame, key=_frame)


def survey(
    entries: Iterable[IndexEntry],
    *,
    complete: bool,
    unfinished_bytes: int = 0,
    damage: Iterable[StreamError] = (),
    frames_declared: int = 0,
) -> Survey:
    """A survey whose frames are checked for their order; ``frames_declared`` by the end packet.

    Raises StreamError "frame-order", or "too-large" when more frames are missing than a reader conceals.
    """
    entries = tuple(entries)
    for before, after in pairwise(entries):
        if after.frame <= before.frame:
            message = f"frame {after.frame} comes after frame {before.frame}"
            raise StreamError(Reason.FRAME_ORDER, message, offset=after.offset)
    frame_count = max(entries[-1].frame + 1 if entries else 0, frames_declared)
    check_lost(frame_count - len(entries), len(entries))
    return Survey(entries, frame_count, complete, unfinished_bytes, tuple(damage))


def lost_frames_within(intact: int) -> int:
    """How many frames may be missing from a stream of which ``intact`` frames are there."""
    return min(MAX_LOST_FRAMES, _MIN_LOST + _LOST_FOR_EACH * intact)


def check_lost(frames: int, intact: int) -> None:
    """Raises StreamError "too-large" when so many frames are missing beside those found that a stream is refused."""
    limit = lost_frames_within(intact)
    if frames > limit:
        message = f"{frames} frames are missing, above the limit of {limit} for the {intact} that are there"
        raise StreamError(Reason.TOO_LARGE, message)


def check_damage_count(indices: int, error: StreamError) -> None:
    """Raises StreamError "too-large" when, with this one, so many places are damaged that the stream is refused."""
    if indices > MAX_DAMAGED_PLACES:
        raise StreamError(Reason.TOO_LARGE, "the stream is damaged in too many places", offset=error.offset)


def is_damage(error: StreamError) -> bool:
    """Whether bytes changed or went missing; otherwise the stream is foreign to this reader or above a limit."""
    return error.reason in DAMAGE


def next_past_damage(
    reader: PacketReader, conceals: Callable[[StreamError], bool] = is_damage
) -> Packet | StreamError | None:
    """The next packet, or what is wrong where it should be, which is then searched past; None: nothing there yet.

    Raises the StreamErrors that ``conceals`` says no to.
    """
    try:
        return reader.next()
    except StreamError as error:
        if not conceals(error):
            raise
        if not reader.ended:
            reader.resynchronise()
        return error


def past_unfinished(reader: PacketReader) -> StreamError | None:
    """Moves into a packet that will not become whole, to an intact packet header inside it.

    That means that bytes are missing, which the result says; None when the stream just stops.
    """
    offset = reader.offset
    if not reader.pending or reader.resynchronise() is None:
        return None
    return StreamError(Reason.TRUNCATED, "a packet is not there in full", offset=offset)


def search(reader: PacketReader, *, max_frames: int) -> Survey:
    """The survey of a damaged stream, read from its start: every intact frame packet, whatever lies between.

    Raises StreamError when the stream is of another version, above a limit, or damaged in too many places.
    """
    packets = _Search(max_frames)
    while True:
        here, unfinished = next_past_damage(reader), reader.pending
        if here is None:
            here = past_unfinished(reader)
        if here is None:
            return packets.survey(reader.ended, unfinished)
        if isinstance(here, Packet):
            packets.packet(here)
        else:
            packets.damage(here)
            if reader.ended:
                return packets.survey(complete=True, unfinished_bytes=0)


class _Search:
    """What a search has come upon so far."""

    def __init__(self, max_frames: int) -> None:
        self._max_frames = max_frames
        self._entries: list[IndexEntry] = []
        self._damage: list[StreamError] = []
        self._frames_declared = 0

    def packet(self, packet: Packet) -> None:
        if packet.kind == PacketKind.END:
            self._frames_declared = end_fields(packet)[0]
        if packet.kind not in FRAME_KINDS:
            return
        if self._entries and packet.frame <= self._entries[-1].frame:
            message = f"frame {packet.frame} comes after frame {self._entries[-1].frame}"
            self.damage(StreamError(Reason.FRAME_ORDER, message, offset=packet.offset))
        elif len(self._entries) == self._max_frames:
            message = f"more frames than the limit of {self._max_frames}"
            raise StreamError(Reason.TOO_LARGE, message, offset=packet.offset)
        else:
            self._entries.append(IndexEntry(packet.offset, packet.frame, packet.kind))

    def damage(self, error: StreamError) -> None:
        self._damage.append(error)
        check_damage_count(len(self._damage), error)

    def survey(self, complete: bool, unfinished_bytes: int) -> Survey:
        return survey(
            self._entries,
            complete=complete,
            unfinished_bytes=unfinished_bytes,
            damage=self._damage,
            frames_declared=self._frames_declared,
        )


def _frame(entry: IndexEntry) -> int:
    return entry.frame


def _offset(error: StreamError) -> int:
    return error.offset or 0
