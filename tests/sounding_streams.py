"""Streams with sound: a tone that is another one in every second."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.sound import RATE, SoundTrack
from decogs.decoder.sound.coding import coded
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, StreamWriter
from packets import iterate_packets

FIRST_TONE, STEP = 400.0, 150.0
"""Hertz in the first second, and how much higher each one after it is."""


def tones(seconds: int, channels: int) -> np.ndarray:
    """Samples (channels, N); a second's tone fades in and out within 5 ms."""
    clock = np.arange(RATE) / RATE
    fade = np.clip(np.minimum(clock, 1 - clock) / 0.005, 0, 1)
    parts = [0.5 * fade * np.sin(2 * np.pi * (FIRST_TONE + STEP * second) * clock) for second in range(seconds)]
    return np.tile(np.concatenate(parts).astype(np.float32), (channels, 1))


def with_sound(source: Path, path: Path, tracks: Sequence[SoundTrack] = (SoundTrack(2),)) -> Path:
    """The stream with tones on these tracks."""
    file, writer = io.BytesIO(), None
    sounds: list[object] = []
    for packet in iterate_packets(io.BytesIO(source.read_bytes())):
        if packet.kind == PacketKind.HEADER:
            header = StreamHeader.from_bytes(packet.payload)
            assert header.fps is not None
            writer = StreamWriter(file, replace(header, sound=tuple(tracks)).to_bytes())
            for number, track in enumerate(tracks):
                sounds.append(coded([tones(20, track.channels)], track.channels, header.fps, track=number))
        elif packet.kind in FRAME_KINDS:
            writer.write(packet.kind, packet.frame, packet.payload)
            for sound in (one for coming in sounds for one in next(coming)):
                writer.write(PacketKind.SOUND, packet.frame, sound.payload())
    writer.finish()
    path.write_bytes(file.getvalue())
    return path
