"""``retime``: which frames play, how fast, and which way. Nothing is made up between two frames."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from decogs.codec.scene.state import ARRAYS, State
from decogs.formats.cli.command_line import Parser, frame_rate, number, whole_number
from decogs.formats.errors import UsageError
from decogs.formats.frames.ranges import frame_range

from ..segments import segment_of
from ..sound import PlayedSpan, played
from ..take import Frame, Take
from .base import Opener, Operation

_MOST_FRAMES = 1 << 20
_DIGITS = 9
_MOST_BUFFERED = 1 << 30
"""Bytes of a segment that is played backwards, which has to be in memory as a whole."""


@dataclass(frozen=True)
class Speed:
    """Frames ``start`` to ``stop``, None for the end, at a speed that goes evenly from ``begin`` to ``end``."""

    start: int
    stop: int | None
    begin: float
    end: float


@dataclass(frozen=True)
class Retime(Operation):
    """Plays frames at other times; every scene that is shown keeps its bits.

    ``speeds``: frames are left out above a speed of 1, and repeated below it; where several name a frame, the last
    counts. ``holds``: pairs of a frame and how many frames longer it stays. ``reverse``: backwards, once that is done;
    a segment at a time is in memory then. ``fps``: frames per second, None as before. Frames are those of the take that
    comes in. Sound plays at the speed of its frames, higher or lower, and backwards; frames that are held are silent.
    """

    speeds: tuple[Speed, ...] = ()
    holds: tuple[tuple[int, int], ...] = ()
    reverse: bool = False
    fps: float | None = None
    name = "retime"
    summary = "change frame rate and speed, hold frames, play backwards"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The frames in their new order. Raises UsageError for frames and speeds that are none."""
        if self == Retime():
            raise UsageError("retime: nothing is to be done; decogs-edit retime --help lists what can be")
        header = take.header if self.fps is None else replace(take.header, fps=self.fps)
        plays = self._plays(take.frame_count)
        shown = [frame for frame, _ in plays]
        starts = tuple(k for k in range(len(shown)) if _begins(take, shown, k))
        retimed = replace(
            take,
            header=header,
            frame_count=len(shown),
            read=lambda start, stop: _read(take, shown, start, stop),
            starts=starts,
        ).with_poster(lambda frame: shown.index(frame) if frame in shown else None)
        as_before = header.fps == take.header.fps and [play for _, play in plays] == [
            PlayedSpan(frame, frame + 1) for frame in range(take.frame_count)
        ]
        if take.header.sound and header.fps is not None and not as_before:
            sound = played(take, [play for _, play in plays], header.fps)
            retimed = replace(retimed, hear=sound).with_note("retime: sound is coded anew, its pitch that of its speed")
        rate = "" if header.fps is None else f" at {header.fps:g} a second"
        return retimed.with_note(f"retime: {len(shown)} frames of {take.frame_count}{rate}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """What is done, in this order."""
        parser.add_argument(
            "--speed",
            dest="speeds",
            type=_speed,
            action="append",
            default=[],
            metavar="A:B=S",
            help="play frames A:B at S times their speed, or from S1 to S2 evenly by A:B=S1>S2 (repeatable)",
        )
        parser.add_argument(
            "--hold",
            dest="holds",
            type=_hold,
            action="append",
            default=[],
            metavar="N:COUNT",
            help="let frame N stay for COUNT frames more (repeatable)",
        )
        parser.add_argument("--reverse", action="store_true", help="backwards")
        parser.add_argument("--fps", type=frame_rate, metavar="F", help="frames per second")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Retime:
        """Of the options as they are named."""
        return cls(tuple(options.speeds), tuple(options.holds), options.reverse, options.fps)

    def _plays(self, count: int) -> Sequence[tuple[int, PlayedSpan]]:
        """The frame of the take that each new one shows, and what it plays; a frame that is held is silent."""
        speeds: list[tuple[float, float, int, int]] = [(1.0, 1.0, 0, count)] * count
        for speed in self.speeds:
            start, stop, _ = slice(speed.start, speed.stop).indices(count)
            if start >= stop or not all(0 < rate < 1e6 for rate in (speed.begin, speed.end)):
                raise UsageError(
                    f"retime: frames {speed.start}:{'' if speed.stop is None else speed.stop} at {speed.begin:g} to "
                    f"{speed.end:g} is not possible; choose some of 0:{count}, and speeds above 0"
                )
            speeds[start:stop] = [(speed.begin, speed.end, start, stop)] * (stop - start)
        longer = dict(self.holds)
        for frame, more in longer.items():
            if not 0 <= frame < count or more < 0:
                raise UsageError(f"retime: a hold of frame {frame} for {more} is not possible; it has 0:{count}")
        plays: list[tuple[int, PlayedSpan]] = []
        position = 0.0
        while position < count:
            frame = int(position)
            begin, end, start, stop = speeds[frame]
            times = 1 + longer.pop(frame, 0)
            if len(plays) + times > _MOST_FRAMES:
                raise UsageError(f"retime: more than {_MOST_FRAMES} frames; hold shorter, or choose a higher speed")
            step = begin + (end - begin) * (position - start) / (stop - start)
            # Where one speed ends, the next begins with its first frame. Ten steps of a tenth are 1, not a little less.
            after = min(round(position + step, _DIGITS), float(stop))
            plays.append((frame, PlayedSpan(position, after)))
            plays += [(frame, PlayedSpan(after, after))] * (times - 1)
            position = after
        return [(frame, PlayedSpan(play.end, play.begin)) for frame, play in reversed(plays)] if self.reverse else plays


def _begins(take: Take, shown: Sequence[int], k: int) -> bool:
    """Whether a segment begins with a new frame: its scene is of another one than that before it."""
    return not k or segment_of(take, shown[k]) != segment_of(take, shown[k - 1])


def _read(take: Take, shown: Sequence[int], start: int, stop: int) -> Iterator[Frame]:
    k = start
    while k < stop:
        backwards = next((other < shown[k] for other in shown[k:stop] if other != shown[k]), False)
        end = k + 1
        while end < stop and (shown[end] == shown[end - 1] or (shown[end] < shown[end - 1]) == backwards):
            end += 1
        for frame in (_backwards if backwards else _forwards)(take, shown[k:end]):
            yield replace(frame, is_key=_begins(take, shown, k))
            k += 1


def _forwards(take: Take, numbers: Sequence[int]) -> Iterator[Frame]:
    """Frames whose numbers do not fall, some passed over, some repeated."""
    coming = take.read(numbers[0], numbers[-1] + 1)
    frame, at = next(coming), numbers[0]
    for wanted in numbers:
        while at < wanted:
            frame, at = next(coming), at + 1
        yield frame


def _backwards(take: Take, numbers: Sequence[int]) -> Iterator[Frame]:
    """Frames whose numbers do not rise, a segment at a time."""
    k = 0
    while k < len(numbers):
        segment = segment_of(take, numbers[k])
        frames = _buffered(take, range(segment.start, numbers[k] + 1))
        while k < len(numbers) and numbers[k] in segment:
            yield frames[numbers[k] - segment.start]
            k += 1


def _buffered(take: Take, numbers: range) -> list[Frame]:
    """The frames, all at once. Raises UsageError where they are too many."""
    frames: list[Frame] = []
    size = 0
    for frame in take.read(numbers.start, numbers.stop):
        size += _bytes_beside(frame.state, frames[-1].state if frames else None)
        if size > _MOST_BUFFERED:
            raise UsageError(
                f"retime: a segment of {len(numbers)} frames is too long to be in memory for playing backwards; encode "
                "with shorter ones, or trim"
            )
        frames.append(frame)
    return frames


def _bytes_beside(state: State, before: State | None) -> int:
    """What a state takes beside the one before, with which it shares what did not change."""
    arrays = [(getattr(state, name), getattr(before, name, None)) for name in (*ARRAYS, "ids", "hashes")]
    return sum(array.nbytes for array, other in arrays if array is not other)


def _hold(text: str) -> tuple[int, int]:
    frame, _, more = text.partition(":")
    return whole_number(frame), whole_number(more)


def _speed(text: str) -> Speed:
    frames, _, rates = text.partition("=")
    begin, _, end = rates.partition(">")
    try:
        chosen = frame_range(frames)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    if chosen is None or (chosen.start or 0) < 0 or (chosen.stop or 0) < 0:
        raise argparse.ArgumentTypeError(f"{text!r}: count frames from the take's start, such as 10:20=0.5")
    return Speed(chosen.start or 0, chosen.stop, number(begin), number(end or begin))
