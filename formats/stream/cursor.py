"""Reading little-endian fields from bytes of a stranger: every length is checked before it is used."""

from __future__ import annotations

import struct
from typing import NoReturn

from ..errors import StreamError
from .reasons import Reason

_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")


class Cursor:
    """A bounded position in the payload of one packet.

    ``packet`` is the packet's ordinal and ``offset`` the stream offset of the payload's first byte; both only serve the
    error messages. Every read past the end raises StreamError("bad-payload").
    """

    def __init__(self, data: bytes, *, packet: int | None = None, offset: int = 0) -> None:
        self._data = memoryview(data)
        self._packet = packet
        self._offset = offset
        self.position = 0

    @property
    def remaining(self) -> int:
        """Bytes between the position and the payload's end."""
        return len(self._data) - self.position

    def take(self, size: int) -> memoryview:
        """The next ``size`` bytes, without copying."""
        if size > self.remaining:
            self.fail(Reason.BAD_PAYLOAD, f"a field of {size} bytes does not fit in the {self.remaining} left")
        start = self.position
        self.position += size
        return self._data[start : self.position]

    def u8(self) -> int:
        """The next byte."""
        return self.take(1)[0]

    def u32(self) -> int:
        """The next 4 bytes, little-endian and unsigned."""
        value: int = _U32.unpack(self.take(4))[0]
        return value

    def u64(self) -> int:
        """The next 8 bytes, little-endian and unsigned."""
        value: int = _U64.unpack(self.take(8))[0]
        return value

    def finish(self) -> None:
        """The payload ends here: raises StreamError("bad-payload") when bytes are left."""
        if self.remaining:
            self.fail(Reason.BAD_PAYLOAD, f"{self.remaining} bytes follow the last field")

    def fail(self, reason: str, message: str) -> NoReturn:
        """Raises the StreamError that names this place."""
        raise StreamError(reason, message, packet=self._packet, offset=self._offset + self.position)
