"""A decoder of .dgs streams in plain Python, written from formats/SPEC.md alone: the specification's proof.

It shares no code with the package, and uses the standard library and, for zstd frames (RFC 8878), `zstandard`. It is
slow on purpose: lists of integers, one step of the specification after the other. Its rooms follow
SPEC.md: plain_container.py (sections 1 to 3), plain_header.py (4), plain_state.py (5), plain_payload.py (6); frame by
frame (7) is here.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

from plain_container import (
    DELTA,
    END,
    FRAME_KINDS,
    HEADER,
    INDEX,
    KEY,
    SOUND,
    Broken,
    Limits,
    Packet,
    check_end,
    check_prologue,
    index_is_right,
    located,
    packets,
    refuse,
)
from plain_header import Header, read_header
from plain_payload import Sound, corrections, delta, key, skip, sound
from plain_state import State, digest

# Section 7: frame by frame


@dataclass(frozen=True)
class Decoded:
    """A stream read in order as far as it can be: header, the state after each frame, and why it stops, if it does.

    `indexes` tells of each index packet, for which a reader that does not seek has no use, whether it is right;
    `sounds` are the SOUND packets that a reader can play.
    """

    header: Header | None
    states: list[State]
    failure: Broken | None
    indexes: list[bool]
    sounds: list[Sound]


def decode(data: bytes, limits: Limits | None = None) -> Decoded:
    """Decode a whole stream from its first byte to its last."""
    header: Header | None = None
    states: list[State] = []
    frames: list[Packet] = []
    indexes: list[bool] = []
    sounds: list[Sound] = []
    of_frame = 0
    limits = limits or Limits()
    try:
        with located(None, 0):
            check_prologue(data)
        for packet in packets(data, limits):
            with located(packet.number, packet.offset):
                if packet.kind == HEADER:
                    header = read_header(packet.payload)
                elif packet.kind == INDEX:
                    indexes.append(index_is_right(packet, frames))
                elif packet.kind == END:
                    check_end(packet, len(frames))
                elif packet.kind == SOUND:
                    of_frame += packet.frame == len(frames) - 1
                    sounds += sound(packet, header, len(frames) - 1) if of_frame <= 64 else []
                elif packet.kind in FRAME_KINDS:
                    states.append(frame(packet, header, states, limits))
                    frames.append(packet)
                    of_frame = 0
    except Broken as broken:
        return Decoded(header, states, broken, indexes, sounds)
    return Decoded(header, states, None, indexes, sounds)


def frame(packet: Packet, header: Header, states: list[State], limits: Limits) -> State:
    if packet.kind != KEY and not states:
        refuse("missing-key")
    if packet.frame != len(states):
        refuse("frame-order")
    faults, packet = corrections(packet, header)
    if packet.kind == KEY:
        told, state = key(packet, header, states[0] if states else None, limits)
    elif packet.kind == DELTA:
        told, state = delta(packet, header, states[-1], limits)
    else:
        told, state = skip(packet, states[-1])
    if digest(state, sum(header.channels)) != told:
        refuse("digest-mismatch")
    return replace(state, corrections=faults)


def main() -> int:
    """Print the digest of each frame of the stream named on the command line, and why decoding stops."""
    decoded = decode(Path(sys.argv[1]).read_bytes())
    for state in decoded.states:
        channels = sum(decoded.header.channels) if decoded.header else 0
        print(f"frame {state.frame}: {len(state.ids)} Gaussians, digest {digest(state, channels):016x}")
    if decoded.failure is None:
        return 0
    print(f"{decoded.failure.reason} in packet {decoded.failure.packet} at byte {decoded.failure.offset}")
    return 2


if __name__ == "__main__":
    sys.exit(main())
