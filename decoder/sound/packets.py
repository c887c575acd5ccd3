"""The SOUND packets behind the packet of a frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from decogs.codec.packets.sound import MAX_PACKETS, SoundPacket, SoundTrack, read_sound
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, PacketReader

FrameSound = tuple[SoundPacket, ...]
"""The packets of one frame, in the order of the stream."""


def sound_behind(
    frame: int,
    reader: PacketReader,
    end: int | None,
    tracks: Sequence[SoundTrack],
    pass_over: Callable[[StreamError], None],
) -> FrameSound:
    """The sound of ``frame`` that ``reader``, which stands behind its packet, comes to before the offset ``end``.

    ``end``: where the next frame's packet lies, None behind the last. ``pass_over`` is called with what is wrong with a
    packet; its sound is not there then. A frame's packets beyond `MAX_PACKETS` are not looked at.
    """
    packets: list[SoundPacket] = []
    looked_at = 0
    try:
        while looked_at < MAX_PACKETS and (end is None or reader.offset < end):
            packet = reader.next()
            if packet is None or packet.kind in FRAME_KINDS or packet.kind == PacketKind.REFINE:
                break
            if packet.kind == PacketKind.SOUND and packet.frame == frame:
                looked_at += 1
                try:
                    packets.append(read_sound(packet, tracks))
                except StreamError as error:
                    pass_over(error)
    except StreamError as error:
        error.sound_of = frame
        pass_over(error)
    return tuple(packets)
