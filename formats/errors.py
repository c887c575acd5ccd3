"""What can go wrong, said in one line: every exception that may leave the library.

A command prints such an error as one line and exits with code 2; anything else that escapes is a bug.
"""

from __future__ import annotations

import os


class DecogsError(Exception):
    """A problem the user can act on; the message names the file, what is wrong and what to do."""


class RigError(DecogsError):
    """A rig folder that cannot be read as synchronised, calibrated cameras."""


class RecordingEnded(RigError):
    """Cameras that were recording bring no new frame: the frames read until then are all there are."""


class UsageError(DecogsError):
    """Options or arguments that do not fit together, or do not fit the input."""


class TryAgainError(UsageError):
    """What may go away by itself or on another machine: a full disk, a file that another process is writing."""


class TrainingError(DecogsError):
    """Training that cannot go on (no points, non-finite values)."""


def check_utf8(path: str | os.PathLike[str]) -> None:
    """Raises UsageError for a name that is no UTF-8, for libraries that know no other and crash or fail on it."""
    try:
        os.fspath(path).encode("utf-8")
    except UnicodeEncodeError:
        raise UsageError(
            f"{os.fspath(path)!a}: the name is not UTF-8, which this kind of file needs; rename it"
        ) from None


class StreamError(DecogsError):
    """A .dgs stream that is damaged, truncated, hostile or of a version this reader does not know.

    ``reason`` is a stable code from SPEC.md, section "Reason codes"; ``packet`` the packet's ordinal from 0 (None
    before the first packet); ``offset`` the byte offset in the stream (None when it has no place); ``sound_of`` the
    frame whose sound is lost by it (None where that is not known).
    """

    def __init__(self, reason: str, message: str, *, packet: int | None = None, offset: int | None = None) -> None:
        where = "" if packet is None else f" in packet {packet}"
        where += "" if offset is None else f" at byte {offset}"
        super().__init__(f"{message}{where} [{reason}]")
        self.reason = reason
        self.packet = packet
        self.offset = offset
        self.sound_of: int | None = None
