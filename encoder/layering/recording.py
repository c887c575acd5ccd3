"""A stream that is put in layers while it grows: a base is trained on its first frame, and follows what moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.layer_list import Layer
from decogs.codec.packets.frame_payload import FramePayload, split_payload
from decogs.codec.reconstruct import reconstruct_frame
from decogs.decoder.editing.layers import LayerWriter
from decogs.decoder.editing.operations.layer import SHARE
from decogs.decoder.editing.take import Frame
from decogs.formats.stream.container import FRAME_KINDS, LAYERED_VERSION, Packet, PacketKind

from ..output.stream_output import StreamOutput, WrappedOutput
from ..training.method import MAX_GROWTH
from .movers import Movers
from .rounds import Footage, Round, RoundMaker

_MOST_SHARE = 0.5
"""Of the most Gaussians that an encode may come to: a base that grows above it is chosen anew."""


class LayeredOutput(WrappedOutput):
    """Writes a stream's packets in two layers into ``inner``; all together give the very Gaussians of each frame.

    The base is chosen and trained at the first frame, and follows what moves. What refines a segment is kept in memory
    up to its end, behind which it is written. The header lists the most Gaussians that the encode may come to; bytes
    are not known.
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
        self._most = round(MAX_GROWTH * len(self._first))
        self._base, self._movers = self._new_base()
        base = Layer(round(_MOST_SHARE * self._most), 0.0, float(np.mean(self._base.likeness)))
        header = replace(header, layers=(base, Layer(self._most, 0.0)))
        output.begin(header.to_bytes(), LAYERED_VERSION)
        self._writer = LayerWriter(header, output)
        self._write(payload)

    def add(self, packet: Packet) -> None:
        """The next frame; of another scene a base is trained first."""
        payload, before = split_payload(packet, self._header.corrected), self._state
        self._state = reconstruct_frame(before, payload, self._header, first=self._first).state
        stay = np.isin(self._base.ids, self._state.ids, assume_unique=True)
        if packet.kind == PacketKind.KEY and 2 * stay.sum() < len(stay):
            self._base, self._movers = self._new_base()
        else:
            self._base = self._movers.joined(self._base, before, self._state)
            if len(self._base.ids) > _MOST_SHARE * self._most:
                self._base, self._movers = self._new_base()
        self._write(payload)

    def finish(self, frames: int) -> None:
        """Writes what refines the first ``frames`` and is still held back."""
        self._writer.finish(frames)

    def _new_base(self) -> tuple[Round, Movers]:
        """A base of the scene as it is now, of which nothing has moved."""
        base = self._maker.made(Footage([self._state], []), None, np.zeros(0, np.int64))
        return base, Movers(self._state, self._header.lattice)

    def _write(self, payload: FramePayload) -> None:
        is_key = payload.body.kind == PacketKind.KEY
        self._writer.write(Frame(self._state, payload.corrections, is_key, base=self._base.base(self._state)))
