"""Sound while a take is edited: where one begins in its midst, and at other speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np

from decogs.codec.packets.sound import BLOCK, CONTINUES, PRE_ROLL, RATE, SoundPacket, SoundTrack, frame_start
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray

from ..sound.coding import coded
from ..sound.packets import FrameSound
from ..sound.samples import decode_tracks, frames_before
from .take import SoundReader, Take

_LOBES = 16
"""Zero crossings of the sinc on either side: 80 dB with its window."""
_FASTEST = 16.0
"""Speed above which nothing is heard: speech would lie above 16 kHz for the most part."""
_AT_ONCE = 1024


def from_frame(take: Take, start: int) -> SoundReader:
    """The sound from frame ``start`` on, counted from there; the first one brings what its decoder needs before it."""
    fps = take.header.fps
    if not start or fps is None:
        return take.hear

    def hear(first: int, stop: int) -> Iterator[FrameSound]:
        coming = take.hear(start + first, start + stop)
        if not first and stop:
            next(coming)
            return chain([_beginning(take, start, fps)], coming)
        return coming

    return hear


def _beginning(take: Take, start: int, fps: float) -> FrameSound:
    """The packets of frame ``start`` with the blocks before it that are heard in it or make the decoder right."""
    runs: dict[int, list[tuple[int, bytes]]] = {}
    ends: dict[int, int] = {}
    first, start_sample, stop = max(0, start - frames_before(fps)), frame_start(start, fps), frame_start(start + 1, fps)
    for frame, packets in enumerate(take.hear(first, start + 1), start=first):
        for packet in packets:
            at = frame_start(frame, fps) + packet.offset
            run = runs.setdefault(packet.track, [])
            if abs(ends.get(packet.track, at) - at) > CONTINUES:
                run.clear()
            samples_at = [at + number * BLOCK for number in range(len(packet.blocks))]
            coming = zip(samples_at, packet.blocks, strict=True)
            run += [(at, block) for at, block in coming if start_sample - PRE_ROLL - BLOCK < at < stop]
            ends[packet.track] = samples_at[-1] + BLOCK
    kept = []
    for track, run in runs.items():
        if run and run[-1][0] + BLOCK > start_sample:
            kept.append(SoundPacket(track, run[0][0] - start_sample, tuple(block for _, block in run)))
    return tuple(kept)


def renumbered(hear: SoundReader, first: int) -> SoundReader:
    """The same sound, its tracks counted from ``first``."""

    def again(start: int, stop: int) -> Iterator[FrameSound]:
        for packets in hear(start, stop):
            yield tuple(replace(packet, track=packet.track + first) for packet in packets)

    return again


@dataclass(frozen=True)
class PlayedSpan:
    """What a frame plays: of the take, from one place to another, in frames; the same place twice is silence."""

    begin: float
    end: float


def played(take: Take, plays: Sequence[PlayedSpan], fps: float) -> SoundReader:
    """The take's sound as new frames of this rate play it: coded anew, higher or lower with its speed."""
    voices = [
        coded(_voice(take, number, plays, fps), track.channels, fps, track=number)
        for number, track in enumerate(take.header.sound)
    ]
    return remembered(tuple(chain.from_iterable(own)) for own in zip(*voices, strict=True))


def with_file(take: Take, path: Path, channels: int, begin: float, fps: float) -> SoundReader:
    """The take's sound and, as one more track, that of a file from ``begin`` seconds on."""
    from decogs.formats.sound.tracks import read_samples

    samples = read_samples(path, channels, begin=begin)
    first = next(samples, None)
    if first is None or begin < -take.frame_count / fps:
        raise UsageError(f"{path}: nothing of it is heard when it begins at second {begin:g}; choose another one")
    number = len(take.header.sound)
    added = remembered(coded(chain([first], samples), channels, fps, track=number))

    def hear(start: int, stop: int) -> Iterator[FrameSound]:
        return (old + new for old, new in zip(take.hear(start, stop), added(start, stop), strict=True))

    return hear


def remembered(coming: Iterator[FrameSound]) -> SoundReader:
    """Sound that can be made in order only, from frame 0 on; coded, it takes 60 MB an hour."""
    made: list[FrameSound] = []

    def hear(start: int, stop: int) -> Iterator[FrameSound]:
        for frame in range(start, stop):
            while len(made) <= frame:
                made.append(next(coming))
            yield made[frame]

    return hear


def _voice(take: Take, number: int, plays: Sequence[PlayedSpan], fps: float) -> Iterator[FloatArray]:
    old = take.header.fps
    assert old is not None
    read = _tape(take, number, take.header.sound[number], old)
    for frame, play in enumerate(plays):
        count = frame_start(frame + 1, fps) - frame_start(frame, fps)
        yield _stretched(read, play.begin * RATE / old, play.end * RATE / old, count)


Tape = Callable[[int, int], FloatArray]
"""Samples (channels, N) from one place up to another, silence outside of the take."""


def _tape(take: Take, number: int, track: SoundTrack, fps: float) -> Tape:
    step = int(np.ceil(fps))

    @lru_cache(maxsize=4)
    def second(part_number: int) -> FloatArray:
        """So many frames, in which a second passes."""
        begin, end = part_number * step, min((part_number + 1) * step, take.frame_count)
        first = max(0, begin - frames_before(fps))
        own = (
            tuple(replace(packet, track=0) for packet in packets if packet.track == number)
            for packets in take.hear(first, end)
        )
        pieces = [piece for (piece,) in decode_tracks(own, [track], fps, first)]
        return np.concatenate(pieces[begin - first :], axis=1)

    def read(start: int, stop: int) -> FloatArray:
        samples = np.zeros((track.channels, stop - start), np.float32)
        for part_number in range(max(0, int(start * fps / RATE) // step - 1), -(-take.frame_count // step)):
            begin = frame_start(part_number * step, fps)
            if begin >= stop:
                break
            end = frame_start(min((part_number + 1) * step, take.frame_count), fps)
            low, high = max(begin, start), min(end, stop)
            if low < high:
                samples[:, low - start : high - start] = second(part_number)[:, low - begin : high - begin]
        return samples

    return read


def _stretched(read: Tape, begin: float, end: float, count: int) -> FloatArray:
    """``count`` samples that go from one place of the tape to another, forwards or backwards, without aliases."""
    channels = read(0, 0).shape[0]
    speed = abs(end - begin) / max(count, 1)
    if not 0 < speed <= _FASTEST:
        return np.zeros((channels, count), np.float32)
    band = min(1.0, 1 / speed)
    reach = int(np.ceil(_LOBES / band))
    pieces = [np.zeros((channels, 0), np.float32)]
    frame_positions = begin + (end - begin) * np.arange(count) / count
    for part in (frame_positions[start : start + _AT_ONCE] for start in range(0, count, _AT_ONCE)):
        taps = np.floor(part).astype(np.int64)[:, None] + np.arange(1 - reach, reach + 1)
        apart = part[:, None] - taps
        weights = band * np.sinc(band * apart) * np.cos(np.pi / 2 * apart / reach) ** 2
        low = int(taps.min())
        around = read(low, int(taps.max()) + 1)
        pieces.append(np.einsum("cnt,nt->cn", around[:, taps - low], weights).astype(np.float32))
    return np.concatenate(pieces, axis=1)
