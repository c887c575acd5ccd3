"""Reconstruction: the one function that encoder and decoder both call on the bytes of a frame (SPEC.md, "Decoding")."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, NoReturn

from decogs.formats.errors import StreamError
from decogs.formats.stream.container import PACKET_HEADER_SIZE, Packet, PacketKind
from decogs.formats.stream.reasons import Reason

from .header.header import StreamHeader
from .packets.deltas import Changes, Delta, apply_delta
from .packets.frame_payload import FramePayload, split_payload
from .packets.syntax import read_delta, read_key, read_skip
from .scene.digest import digest
from .scene.state import DEFAULT_MAX_GAUSSIANS, State


class Reconstruction(NamedTuple):
    """The state after a frame and what its packet changed; ``delta``: that of a delta packet, None otherwise."""

    state: State
    changes: Changes
    delta: Delta | None = None


def reconstruct(
    state: State | None,
    packet: Packet,
    header: StreamHeader,
    *,
    first: State | None = None,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
) -> State:
    """The state after a key, delta or skip packet as it lies in the stream; see ``reconstruct_frame``."""
    payload = split_payload(packet, header.corrected)
    return reconstruct_frame(state, payload, header, first=first, max_gaussians=max_gaussians).state


def reconstruct_frame(
    state: State | None,
    payload: FramePayload,
    header: StreamHeader,
    *,
    first: State | None = None,
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS,
) -> Reconstruction:
    """What follows ``state``, which is None where decoding begins, by the payload of a key, delta or skip packet.

    ``first``: the state of the stream's first keyframe, to which later ones may refer (``refers_to_first``).

    Integer arithmetic only, so that every machine gets the same bits. The digest in the packet is compared with the
    result's. Corrections of cameras are passed over: the scene knows nothing of them. Raises StreamError, whatever the
    payload holds.
    """
    following, declared = _advance(state, payload.body, header, first, max_gaussians)
    if digest(following.state) != declared:
        _refuse(payload.body, Reason.DIGEST_MISMATCH, "the reconstructed state is not the encoder's")
    return following


def _advance(
    state: State | None, packet: Packet, header: StreamHeader, first: State | None, max_gaussians: int
) -> tuple[Reconstruction, int]:
    if packet.kind == PacketKind.KEY:
        if state is not None and packet.frame <= state.frame:
            _refuse(packet, Reason.FRAME_ORDER, f"frame {packet.frame} comes after frame {state.frame}")
        key = read_key(packet, header.coefficients, max_gaussians, first=first)
        return Reconstruction(key.state, key.changes), key.digest
    if packet.kind not in (PacketKind.DELTA, PacketKind.SKIP):
        _refuse(packet, Reason.MISPLACED_PACKET, f"a packet of kind {packet.kind} holds no frame")
    if state is None:
        _refuse(packet, Reason.MISSING_KEY, f"frame {packet.frame} needs a keyframe before it")
    if packet.frame != state.frame + 1:
        _refuse(packet, Reason.FRAME_ORDER, f"frame {packet.frame} follows frame {state.frame}")
    if packet.kind == PacketKind.SKIP:
        return Reconstruction(replace(state, frame=packet.frame), Changes(0, 0, 0)), read_skip(packet)
    delta, declared = read_delta(packet, state, max_gaussians)
    return Reconstruction(apply_delta(state, delta), delta.changes, delta), declared


def _refuse(packet: Packet, reason: str, message: str) -> NoReturn:
    raise StreamError(reason, message, packet=packet.ordinal, offset=packet.offset + PACKET_HEADER_SIZE)
