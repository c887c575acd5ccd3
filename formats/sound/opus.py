"""Opus, by FFmpeg (PyAV): blocks of 20 ms at 48 kHz, one by one. Source: RFC 6716."""

from __future__ import annotations

import struct
from fractions import Fraction
from typing import Any

import av
import numpy as np

from ..splats import FloatArray

RATE = 48_000
BLOCK = 960
"""Samples of a block."""
BITS = 64_000
"""A second, for each channel: what listeners do not tell from the source. Source: Opus recommended settings, Xiph."""

_LAYOUTS = {1: "mono", 2: "stereo"}
_HEAD = struct.Struct("<8sBBHIhB")


class OpusEncoder:
    """Codes blocks (channels, BLOCK) of samples; what goes in at sample 0 comes out of a decoder at ``delay``."""

    def __init__(self, channels: int) -> None:
        self._layout = _LAYOUTS[channels]
        self._context: Any = av.CodecContext.create("libopus", "w")
        self._context.sample_rate, self._context.layout, self._context.format = RATE, self._layout, "flt"
        self._context.bit_rate, self._context.time_base = BITS * channels, Fraction(1, RATE)
        self._context.options = {"frame_duration": "20", "application": "audio"}
        self._context.open()
        self._at = 0
        # A libopus that says otherwise would break every time in a stream.
        if self._context.frame_size != BLOCK:
            raise RuntimeError(f"this libopus codes {self._context.frame_size} samples at a time, not {BLOCK}")

    @property
    def delay(self) -> int:
        """Samples that a decoder gives before the first one that was coded."""
        return int(_HEAD.unpack(bytes(self._context.extradata)[: _HEAD.size])[3])

    def code(self, samples: FloatArray) -> list[bytes]:
        """The blocks that are whole once these samples are in."""
        interleaved = np.ascontiguousarray(samples.T, np.float32).reshape(1, -1)
        frame = av.AudioFrame.from_ndarray(interleaved, format="flt", layout=self._layout)
        frame.sample_rate, frame.pts, frame.time_base = RATE, self._at, Fraction(1, RATE)
        self._at += BLOCK
        return [bytes(packet) for packet in self._context.encode(frame)]

    def finish(self) -> list[bytes]:
        """The blocks that hold what the delay kept back."""
        return [bytes(packet) for packet in self._context.encode(None)]


class OpusDecoder:
    """Decodes blocks, one after the other."""

    def __init__(self, channels: int) -> None:
        self._silence = np.zeros((channels, BLOCK), np.float32)
        # The decoder of FFmpeg itself gives floats, that of libopus 16 bits.
        self._context: Any = av.CodecContext.create("opus", "r")
        self._context.sample_rate, self._context.layout = RATE, _LAYOUTS[channels]
        self._context.extradata = _HEAD.pack(b"OpusHead", 1, channels, 0, RATE, 0, 0)
        self._context.open()

    def decode(self, block: bytes) -> FloatArray:
        """Samples (channels, BLOCK); silence for what is no block of 20 ms."""
        try:
            frames = self._context.decode(av.Packet(block))
        except (av.FFmpegError, ValueError):
            return self._silence
        samples = [frame.to_ndarray() for frame in frames]
        whole = len(samples) == 1 and samples[0].shape == self._silence.shape
        return np.clip(np.nan_to_num(samples[0]), -1, 1) if whole else self._silence
