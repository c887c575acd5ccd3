"""What a take measures that its header tells: Gaussians and bytes, layer by layer."""

from __future__ import annotations

import io
from collections import Counter
from typing import Any

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.layer_list import Layer
from decogs.codec.header.profiles import Load, load
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, StreamWriter

from .take import Frame


class Nowhere(io.BytesIO):
    """Takes bytes and forgets them."""

    def write(self, data: Any) -> int:
        """As if it had kept them."""
        return len(data)


class Meter(StreamWriter):
    """Takes the packets of a stream with this header, and keeps how large they are; `count` is told of each frame."""

    def __init__(self, header: StreamHeader) -> None:
        super().__init__(Nowhere(), b"")
        self._header, self._layers = header, max(1, len(header.layers))
        self._gaussians: list[tuple[int, ...]] = []
        self._sizes, self._sound = Counter[tuple[int, int]](), Counter[int]()

    def write(self, kind: int, frame: int, payload: bytes, *, critical: bool | None = None) -> int:
        """Counts one packet, and returns its size in bytes."""
        size = super().write(kind, frame, payload, critical=critical)
        if kind == PacketKind.SOUND:
            self._sound[frame] += size
        elif kind in FRAME_KINDS or kind == PacketKind.REFINE:
            self._sizes[frame, payload[0] if kind == PacketKind.REFINE else 0] += size
        return size

    def count(self, frame: Frame) -> None:
        """Of a frame's Gaussians, those of each layer with those below."""
        every = len(frame.state)
        self._gaussians.append((every,) if frame.base is None else (len(frame.base), every))

    def layers(self) -> tuple[Layer, ...]:
        """What the header says of layers, with what they measure."""
        return tuple(
            Layer(
                max(each[number] for each in self._gaussians),
                sum(self._bytes(number)) / len(self._gaussians),
                said.psnr,
            )
            for number, said in enumerate(self._header.layers)
        )

    def loads(self) -> list[Load]:
        """What each layer, with those below, asks of a player."""
        header = self._header
        return [load(self._frames(number), header.sh_degree, header.fps) for number in range(self._layers)]

    def _frames(self, layer: int) -> list[tuple[int, int]]:
        sizes = self._bytes(layer)
        return [(each[layer], sizes[frame] + self._sound[frame]) for frame, each in enumerate(self._gaussians)]

    def _bytes(self, layer: int) -> list[int]:
        """Of each frame, without sound."""
        return [sum(self._sizes[frame, each] for each in range(layer + 1)) for frame in range(len(self._gaussians))]
