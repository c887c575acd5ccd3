"""What is heard: the tracks of a stream as samples, a piece for each frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import TYPE_CHECKING, Protocol

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.sound import BLOCK, CONTINUES, PRE_ROLL, RATE, SoundPacket, SoundTrack, frame_start
from decogs.formats.splats import FloatArray

from .packets import FrameSound

if TYPE_CHECKING:
    from decogs.formats.sound.opus import OpusDecoder


class HasSound(Protocol):
    """A stream, as far as its sound goes."""

    @property
    def header(self) -> StreamHeader:
        """With at least one track."""
        ...

    def sounds(self, start: int, stop: int) -> Iterator[FrameSound]:
        """The packets of each frame from one up to another."""
        ...


def frames_before(fps: float) -> int:
    """How many frames before a place have to be read for what is heard there."""
    return int(np.ceil((PRE_ROLL + BLOCK) * fps / RATE))


def mixed_sound(stream: HasSound, frames: range) -> Iterator[FloatArray]:
    """What is heard in these frames of a stream with sound, all tracks together: stereo (2, N), a piece a frame."""
    header = stream.header
    assert header.fps is not None
    first = max(0, frames.start - frames_before(header.fps))
    pieces = decode_tracks(stream.sounds(first, frames.stop), header.sound, header.fps, first)
    return (mixed(voices) for voices in islice(pieces, frames.start - first, None))


def decode_tracks(
    sounds: Iterable[FrameSound], tracks: Sequence[SoundTrack], fps: float, first: int = 0
) -> Iterator[list[FloatArray]]:
    """The samples (channels, N) of each track, for each frame from ``first`` on; silence where there is no sound."""
    voices = [_Voice(track.channels) for track in tracks]
    for frame, packets in enumerate(sounds, start=first):
        begin, end = frame_start(frame, fps), frame_start(frame + 1, fps)
        for number, voice in enumerate(voices):
            voice.take([packet for packet in packets if packet.track == number], begin, end)
        yield [voice.between(begin, end) for voice in voices]


def mixed(voices: Sequence[FloatArray]) -> FloatArray:
    """Tracks of one piece together, stereo (2, N), not above full level."""
    sides = [np.broadcast_to(voice, (2, voice.shape[1])) for voice in voices]
    total: FloatArray = np.sum(sides, axis=0, dtype=np.float32)
    return np.clip(total, -1, 1)


class _Voice:
    """One track while it is decoded; ``_tail`` is what lies behind the last frame that was heard."""

    def __init__(self, channels: int) -> None:
        self._channels = channels
        self._decoder: OpusDecoder | None = None
        self._at: int | None = None
        self._tail = np.zeros((channels, 0), np.float32)

    def take(self, packets: Sequence[SoundPacket], begin: int, end: int) -> None:
        """Decodes the packets of the frame with these samples: of several runs that begin in it only the last is heard.

        Blocks that no sample of the frame depends on are passed over, however many there are.
        """
        from decogs.formats.sound.opus import OpusDecoder

        blocks: list[tuple[int, bytes]] = []
        for packet in packets:
            at = begin + packet.offset
            if self._at is None or abs(at - self._at) > CONTINUES:
                self._decoder, self._at, blocks = None, at, []
                self._tail = self._tail[:, :0]
            for block in packet.blocks:
                if self._at >= end:
                    break
                if self._at + BLOCK > begin - PRE_ROLL:
                    blocks.append((self._at, block))
                self._at += BLOCK
        for at, block in blocks:
            if self._decoder is None:
                self._decoder = OpusDecoder(self._channels)
            samples = self._decoder.decode(block)
            passed = max(0, begin - at)
            if passed < BLOCK:
                self._put(samples[:, passed:], at + passed - begin)

    def _put(self, samples: FloatArray, offset: int) -> None:
        """Samples that are heard from ``offset`` on, counted from the frame's start."""
        before = self._tail[:, :offset]
        silence = np.zeros((self._channels, offset - before.shape[1]), np.float32)
        self._tail = np.concatenate([before, silence, samples], axis=1)

    def between(self, begin: int, end: int) -> FloatArray:
        """What is heard in the frame, which then is over."""
        count = end - begin
        samples, self._tail = self._tail[:, :count], self._tail[:, count:]
        return np.pad(samples, ((0, 0), (0, count - samples.shape[1])))
