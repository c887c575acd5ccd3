"""Sound into a stream while its frames are written: SOUND packets behind each (SPEC.md, "Sound packet")."""

from __future__ import annotations

from itertools import islice

from decogs.formats.stream.container import PacketKind

from ..input.sound import SoundSource
from .stream_output import StreamOutput


class SoundWriter:
    """Writes what ``source`` has for frames of a take, in their order; nothing without a source.

    All of the take is coded, also where only a part of it is written: so parts and resumed encodes have the packets of
    an encode in one go.
    """

    def __init__(self, source: SoundSource | None, output: StreamOutput) -> None:
        self._sounds = None if source is None else source.packets()
        self._output, self._passed = output, 0

    def write(self, frame: int) -> None:
        """Appends the packets of a frame of the take, counted from 0. Raises UsageError where it cannot be read."""
        if self._sounds is None:
            return
        packets = next(islice(self._sounds, frame - self._passed, None))
        self._passed = frame + 1
        for packet in packets:
            self._output.write(PacketKind.SOUND, frame, packet.payload())
