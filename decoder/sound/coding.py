"""Samples coded as SOUND packets, a packet a frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from decogs.codec.packets.sound import BLOCK, SoundPacket, frame_start
from decogs.formats.splats import FloatArray

from .packets import FrameSound

if TYPE_CHECKING:
    from decogs.formats.sound.opus import OpusEncoder


def coded(samples: Iterable[FloatArray], channels: int, fps: float, *, track: int = 0) -> Iterator[FrameSound]:
    """The packets of each frame from 0 on, endlessly; none behind the end of ``samples``.

    ``samples`` (channels, N) at 48 kHz begin with frame 0; no more of them are taken than the frames so far need.
    """
    from decogs.formats.sound.opus import OpusEncoder

    encoder = OpusEncoder(channels)
    blocks = _blocks(encoder, samples, channels)
    at, frame = -encoder.delay, 0
    while True:
        begin, end = frame_start(frame, fps), frame_start(frame + 1, fps)
        offset, own = at - begin, []
        while at < end and (block := next(blocks, None)) is not None:
            own.append(block)
            at += BLOCK
        yield (SoundPacket(track, offset, tuple(own)),) if own else ()
        frame += 1


def _blocks(encoder: OpusEncoder, samples: Iterable[FloatArray], channels: int) -> Iterator[bytes]:
    for block in in_blocks(samples, channels):
        yield from encoder.code(block)
    yield from encoder.finish()


def in_blocks(samples: Iterable[FloatArray], channels: int) -> Iterator[FloatArray]:
    """The same in pieces of BLOCK samples; the last one is filled up with silence."""
    waiting = np.zeros((channels, 0), np.float32)
    for piece in samples:
        waiting = np.concatenate([waiting, piece], axis=1)
        whole = waiting.shape[1] // BLOCK * BLOCK
        yield from (waiting[:, start : start + BLOCK] for start in range(0, whole, BLOCK))
        waiting = waiting[:, whole:]
    if waiting.shape[1]:
        yield np.pad(waiting, ((0, 0), (0, BLOCK - waiting.shape[1])))
