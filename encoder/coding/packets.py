"""Packets from what a frame changes: keyframe, delta or skip, with the frame's corrections."""

from __future__ import annotations

from dataclasses import dataclass, replace

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import CorrectedCameras, Corrections, write_corrections
from decogs.codec.packets.deltas import Delta, apply_delta
from decogs.codec.packets.frame_payload import split_payload
from decogs.codec.packets.syntax import Coded, payload_costs, write_delta, write_key, write_skip
from decogs.codec.scene.state import State
from decogs.formats.stream.container import Packet, PacketKind

from ..settings.frame import SignificanceSettings
from ..training.method import TrainedFrame
from .changes import delta_of
from .scene import Scene


@dataclass(frozen=True)
class Written:
    """A frame's packet, and the bytes of its payload by purpose."""

    packet: Packet
    costs: dict[str, int]


def key_packet(header: StreamHeader, state: State, corrections: Corrections) -> Written:
    """A keyframe in which nothing is left of a scene before it, of the state's frame."""
    return _packet(PacketKind.KEY, state.frame, write_key(state), corrections, header.corrected)


def frame_packet(
    scene: Scene,
    frame: int,
    trained: TrainedFrame | None,
    significance: SignificanceSettings,
    corrections: Corrections,
    *,
    segment: int = 0,
    whole: bool = False,
) -> Written:
    """A later ``frame``, counted from the stream's first, as key, delta or skip, whichever is smallest.

    ``trained``: what it changes of the scene, None for nothing. ``segment``: frames between keyframes.
    ``whole``: the decoder's state is not the scene's (`Scene.roll_back`), so the frame is a keyframe.
    """
    delta = _delta(scene, trained, significance)
    if whole or (segment and frame % segment == 0):
        after = replace(scene.state, frame=frame) if delta is None else apply_delta(scene.state, delta)
        kind, coded = PacketKind.KEY, write_key(after, first=scene.first)
    elif delta is None:
        kind, coded = PacketKind.SKIP, write_skip(scene.state)
    else:
        kind, coded = PacketKind.DELTA, write_delta(scene.state, delta)
    return _packet(kind, frame, coded, corrections, scene.header.corrected)


def read_back(packet: Packet, header: StreamHeader) -> tuple[Written, Corrections]:
    """An earlier encode's packet with its costs, and the corrections in it."""
    corrections, body = split_payload(packet, header.corrected)
    return Written(packet, payload_costs(body, header.coefficients)), corrections


def _delta(scene: Scene, trained: TrainedFrame | None, significance: SignificanceSettings) -> Delta | None:
    """What is to be coded; None for nothing."""
    if trained is None:
        return None
    delta = delta_of(scene.state, scene.header.lattice, trained, significance)
    return delta if len(delta.rows) or len(delta.removed) or len(delta.added) else None


def _packet(kind: PacketKind, frame: int, coded: Coded, corrections: Corrections, cameras: CorrectedCameras) -> Written:
    payload, costs = coded.payload, coded.costs
    if cameras.effects:
        block = write_corrections(corrections, cameras)
        payload, costs = block + payload, {**costs, "corrections": len(block)}
    return Written(Packet(kind=kind, critical=True, frame=frame, payload=payload, offset=0, ordinal=frame + 1), costs)
