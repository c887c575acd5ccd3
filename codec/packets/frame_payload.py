"""A frame packet's payload, split: the cameras' corrections, and the body behind them (SPEC.md, "Corrections")."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from decogs.formats.stream.container import Packet

from .corrections import CorrectedCameras, Corrections, read_corrections
from .syntax import refers_to_first


class FramePayload(NamedTuple):
    """``corrections`` by camera; ``body``: the packet as it is read from behind them on."""

    corrections: Corrections
    body: Packet

    @property
    def refers_to_first(self) -> bool:
        """Whether this is a keyframe that can only be read with the stream's first one."""
        return refers_to_first(self.body)


def split_payload(packet: Packet, corrected: CorrectedCameras) -> FramePayload:
    """The two parts of a frame packet as it lies in the stream; ``corrected``: the header's.

    Raises StreamError "bad-payload" when the payload is shorter than the corrections.
    """
    if not corrected.block_bytes:
        return FramePayload({}, packet)
    corrections = read_corrections(packet.cursor(), corrected)
    return FramePayload(corrections, replace(packet, start=corrected.block_bytes))
