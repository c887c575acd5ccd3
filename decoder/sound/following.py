"""Sound of a stream that still grows: what is heard in frames as these are over."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

from decogs.codec.packets.sound import SoundPacket, SoundTrack
from decogs.formats.splats import FloatArray

from .packets import FrameSound
from .samples import decode_tracks, mixed


class GrowingSound(Iterator[FloatArray]):
    """Stereo samples (2, N) of each frame from ``first`` on, all tracks together.

    Ends where nothing more is known, and goes on when it is asked again later: a frame's sound is known when the next
    one has come. ``frames_over`` says of how many frames it is.
    """

    def __init__(self, tracks: tuple[SoundTrack, ...], fps: float, first: int, frames_over: Callable[[], int]) -> None:
        self._packets: deque[tuple[int, SoundPacket]] = deque()
        self._pieces = decode_tracks(self._sounds(), tracks, fps)
        self._first, self._frames_over, self._passed = first, frames_over, 0

    def take(self, frame: int, packet: SoundPacket) -> None:
        """A packet that came, of this frame."""
        self._packets.append((frame, packet))

    def __next__(self) -> FloatArray:
        while self._passed < self._frames_over():
            voices = next(self._pieces)
            if self._passed > self._first:
                return mixed(voices)
        raise StopIteration

    def _sounds(self) -> Iterator[FrameSound]:
        while True:
            own = []
            while self._packets and self._packets[0][0] <= self._passed:
                own.append(self._packets.popleft()[1])
            self._passed += 1
            yield tuple(own)
