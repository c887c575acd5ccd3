"""A stream that is put in layers while it grows: a base is trained on what has been encoded so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.layer_list import Layer
from decogs.codec.packets.frame_payload import FramePayload, split_payload
from decogs.codec.reconstruct import reconstruct_frame
from decogs.codec.scene.state import Rows, changed_between, same_scene
from decogs.decoder.editing.layers import LayerWriter
from decogs.decoder.editing.operations.layer import SHARE
from decogs.decoder.editing.take import Frame
from decogs.formats.stream.container import FRAME_KINDS, LAYERED_VERSION, Packet, PacketKind

from ..output.stream_output import StreamOutput, WrappedOutput
from ..training.method import MAX_GROWTH
from .rounds import Footage, Round, RoundMaker

_ROUND_FRAMES = 60
_MOMENT_FRAMES = 15
"""Scenes that a round is trained on are so far apart: with the newest alone the base lost a dB until the next round."""


class LayeredOutput(WrappedOutput):
    """Writes a stream's packets in two layers into ``inner``; all together give the very Gaussians of each frame.

    The base is chosen and trained at the first frame, and anew every 60 frames from scenes of the 60 before: training
    holds the encode up for a few seconds then. What refines a segment is kept in memory up to its end, behind which it
    is written. The header lists the most Gaussians that the encode may come to; bytes are not known.
    """

    def __init__(self, inner: StreamOutput, threads: int = 0) -> None:
        super().__init__(inner)
        self._threads = threads
        self._header: StreamHeader | None = None
        self._recording: _Recording | None = None

    def begin(self, header: bytes, version: tuple[int, int] = LAYERED_VERSION) -> None:
        self._header = StreamHeader.from_bytes(header)

    def write(self, kind: int, frame: int, payload: bytes) -> int:
        if kind not in FRAME_KINDS:
            return self._inner.write(kind, frame, payload)
        packet = Packet(PacketKind(kind), frame, payload)
        before = 0 if self._recording is None else self.open().bytes_written
        if self._recording is None:
            assert self._header is not None
            self._recording = _Recording(self._header, packet, self._inner, self._threads)
        else:
            self._recording.add(packet)
        return self.open().bytes_written - before

    def close(self, frames: int) -> None:
        if self._recording is not None and frames and self.cut(frames):
            self._recording.finish(frames)
        self._inner.close(frames)


class _Recording:
    """The frames so far of a stream with this header and ``first`` packet, as they go into ``output``."""

    def __init__(self, header: StreamHeader, first: Packet, output: StreamOutput, threads: int) -> None:
        self._header, self._maker = header, RoundMaker(header, SHARE, threads)
        payload = split_payload(first, header.corrected)
        self._first = self._state = reconstruct_frame(None, payload, header).state
        self._scenes, self._changed, self._age = [self._state], list[Rows](), 0
        self._round = self._new_round(None)
        most = round(MAX_GROWTH * len(self._first))
        base = Layer(round(SHARE * most), 0.0, float(np.mean(self._round.likeness)))
        header = replace(header, layers=(base, Layer(most, 0.0)))
        output.begin(header.to_bytes(), LAYERED_VERSION)
        self._writer = LayerWriter(header, output)
        self._write(payload)

    def add(self, packet: Packet) -> None:
        """The next frame; trains the base first if that is due."""
        payload, before = split_payload(packet, self._header.corrected), self._state
        self._state = reconstruct_frame(before, payload, self._header, first=self._first).state
        if not same_scene(before, self._state):
            self._changed.append(before.ids[changed_between(before, self._state)])
        self._age += 1
        if packet.kind == PacketKind.KEY and len(self._round.base(self._state)) < len(self._round.ids) / 2:
            self._scenes, self._changed = [self._state], []  # a scene of others
            self._round = self._new_round(None)
        elif self._age == _ROUND_FRAMES:
            self._scenes.append(self._state)
            self._round = self._new_round(self._round)
        elif self._age % _MOMENT_FRAMES == 0:
            self._scenes.append(self._state)
        self._write(payload)

    def finish(self, frames: int) -> None:
        """Writes what refines the first ``frames`` and is still held back."""
        self._writer.finish(frames)

    def _new_round(self, before: Round | None) -> Round:
        """Trained on the scenes since the last one, the newest first."""
        footage = Footage(self._scenes[::-1], self._changed)
        self._scenes, self._changed, self._age = [], [], 0
        return self._maker.made(footage, before, footage.moved)

    def _write(self, payload: FramePayload) -> None:
        is_key = payload.body.kind == PacketKind.KEY
        self._writer.write(Frame(self._state, payload.corrections, is_key, base=self._round.base(self._state)))
