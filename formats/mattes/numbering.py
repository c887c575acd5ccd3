"""Which frame each of a camera's matte files is of, by the numbers in their names.

Files carry the names or the numbers of the rig's own pictures, or count from 0, at the rig's first frame or the
recording's, or are as many as the frames and follow one another without a gap. Each of these is a reading. Those that
take in every frame come before those of which only some are there; where two that are left differ, nothing is taken.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import RigError
from ..rigs.sources import FrameSource, PictureSource
from ..rigs.timeline import CameraClock, RigIndex, StreamIndex, rig_index

_Numbers = Sequence[tuple[int, ...]]
_REMEDY = "name them as the pictures, or count them from 0 at the rig's first frame"


@dataclass(frozen=True)
class _Reading:
    """The file of each frame that has one; ``is_whole``: the files are as many as the frames that they count."""

    words: str
    files: Mapping[int, Path]
    is_whole: bool

    def has(self, frames: range) -> bool:
        """Whether each of these frames has a file."""
        return all(frame in self.files for frame in frames)

    def has_most(self, frames: range) -> bool:
        """Whether the first and the last of these frames have a file, and most between them: others were lost."""
        exist = [frame in self.files for frame in frames]
        return exist[0] and exist[-1] and 2 * sum(exist) > len(exist)


def mattes_of_recording(
    folder: Path, files: Sequence[Path], recording: FrameSource, clock: CameraClock, count: int, frames: range
) -> tuple[Path, ...]:
    """The files in the order of the rig's ``count`` frames; most of ``frames`` are there, and the first and the last.

    An empty path stands where there is none. Raises RigError for files that fit no frames, or two ways.
    """
    recorded = [clock.recorded_index(RigIndex(frame)) for frame in range(count)]
    by_numbers = list(_by_numbers(files, recording, recorded))
    alone = range(0) if by_numbers else frames  # numbers of its pictures are no sign of counting from 0
    readings = list(_by_names(files, recording, recorded)) or [
        *by_numbers,
        *_counted("count from 0 at the rig's first frame", files, count, range(count), alone),
        *_counted("count from 0 at the recording's first frame", files, recording.frame_count, recorded, alone),
        *_in_order(files, count, range(count)),
        *_in_order(files, recording.frame_count, recorded),
    ]
    return _chosen(folder, files, readings, count, frames, may_lack=True)


def mattes_of_stream(folder: Path, files: Sequence[Path], first: int, count: int, frames: range) -> tuple[Path, ...]:
    """The files in the order of a stream's ``count`` frames, which begins with the rig's frame ``first``.

    Those of ``frames`` are sure to be there. Raises RigError for files that fit no frames, or two ways.
    """
    of_rig = [rig_index(RigIndex(first), StreamIndex(frame)) for frame in range(count)]
    readings = [
        *_counted("count from 0 at the rig's first frame", files, None, of_rig, frames),
        *_counted("count from 0 at the stream's first frame", files, count, range(count), frames),
        *_in_order(files, count, range(count)),
    ]
    return _chosen(folder, files, readings, count, frames)


def _by_names(files: Sequence[Path], recording: FrameSource, recorded: Sequence[int]) -> Iterator[_Reading]:
    if isinstance(recording, PictureSource):
        own, given = [file.stem for file in recording.files], {file.stem: file for file in files}
        if len(given) == len(files) and _belong(list(given), own):
            at = {frame: given[own[index]] for frame, index in enumerate(recorded) if own[index] in given}
            yield _Reading("have the names of its pictures", at, is_whole=True)


def _by_numbers(files: Sequence[Path], recording: FrameSource, recorded: Sequence[int]) -> Iterator[_Reading]:
    own = recording.frame_numbers() if isinstance(recording, PictureSource) else None
    numbers = _numbers(files)
    if own and numbers and _belong(numbers, own):
        given = dict(zip(numbers, files, strict=True))
        at = {frame: given[own[index]] for frame, index in enumerate(recorded) if own[index] in given}
        yield _Reading("have the numbers of its pictures", at, len(files) == len(own))


def _belong(given: Sequence[object], own: Sequence[object]) -> bool:
    """Whether names or numbers are those of the pictures: none is of another, or none of theirs is lacking."""
    return set(given) <= set(own) or (set(own) <= set(given) and given[0] == own[0])


def _counted(
    words: str, files: Sequence[Path], most: int | None, wanted: Sequence[int], alone: range
) -> Iterator[_Reading]:
    """Numbers that count from 0 to below ``most``; ``wanted``: the number of each frame.

    0 is there, or the frames ``alone`` and no others are: else they may count from 1 as well.
    """
    numbers = _numbers(files)
    if numbers and all(len(number) == 1 and (most is None or number[0] < most) for number in numbers):
        given = {number[0]: file for number, file in zip(numbers, files, strict=True)}
        if 0 not in given and set(given) != {wanted[frame] for frame in alone}:
            return
        at = {frame: given[number] for frame, number in enumerate(wanted) if number in given}
        yield _Reading(words, at, len(files) == most)


def _in_order(files: Sequence[Path], count: int, wanted: Sequence[int]) -> Iterator[_Reading]:
    """As many as ``count`` frames, without a gap in their numbers; ``wanted``: the place of each frame's."""
    numbers = _numbers(files)
    steps = {_step(*pair) for pair in zip(numbers or (), (numbers or ())[1:], strict=False)}
    if len(files) == count and len(steps) <= 1:
        yield _Reading("are taken in order", {frame: files[index] for frame, index in enumerate(wanted)}, is_whole=True)


def _step(one: tuple[int, ...], other: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(b - a for a, b in zip(one, other, strict=True))


def _numbers(files: Sequence[Path]) -> _Numbers | None:
    return PictureSource(Path(), tuple(files), 0, 0).frame_numbers()


def _chosen(
    folder: Path,
    files: Sequence[Path],
    readings: Sequence[_Reading],
    count: int,
    frames: range,
    *,
    may_lack: bool = False,
) -> tuple[Path, ...]:
    if not files:
        raise RigError(f"{folder}: no matte of frame {frames.start}; give one for every frame, such as 0000.png")
    if not any(frame in reading.files for reading in readings for frame in frames):
        raise RigError(
            f"{folder}: the numbers of its {len(files)} mattes, {files[0].name} to {files[-1].name}, fit neither its "
            f"camera's pictures nor {count} frames; {_REMEDY}"
        )
    fitting = [reading for reading in readings if reading.has(frames)]
    if not fitting and may_lack:
        fitting = [reading for reading in readings if reading.has_most(frames)]
    if not fitting:
        most = max(readings, key=lambda reading: sum(frame in reading.files for frame in frames))
        lacking = next(frame for frame in frames if frame not in most.files)
        raise RigError(f"{folder}: no matte of frame {lacking}; give one for every frame, such as 0000.png")
    fitting = [reading for reading in fitting if reading.is_whole] or fitting
    best = fitting[0]
    for other in fitting[1:]:
        if any(best.files.get(frame) != other.files.get(frame) for frame in frames):
            raise RigError(
                f"{folder}: it is not sure which frame a matte is of: frame {frames.start} is {_of(best, frames)}, or "
                f"{_of(other, frames)}; {_REMEDY}"
            )
    return tuple(best.files.get(frame, Path()) for frame in range(count))


def _of(reading: _Reading, frames: range) -> str:
    return f"{reading.files[frames.start].name} if they {reading.words}"
